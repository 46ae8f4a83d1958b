"""How many bits the paper's rule allows: bounds, codes, their limits, and why the rule has none."""
