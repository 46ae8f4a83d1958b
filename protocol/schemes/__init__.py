"""How transitions become key symbols and message symbols: automata, and frames."""
