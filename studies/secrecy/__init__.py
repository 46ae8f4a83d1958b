"""The secrecy study: seeded runs, what each eavesdropper made of them, and the tables."""
