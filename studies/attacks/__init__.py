"""The study of the attacks: attack by defence by who has the key."""
