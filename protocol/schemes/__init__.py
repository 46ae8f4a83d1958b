"""How transitions become key symbols and message symbols: schemes, and frames."""
