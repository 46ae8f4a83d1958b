"""Sets computed offline: the terminal set, the recursion, the design and its cache."""
