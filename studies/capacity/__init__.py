"""Limits of the paper's rule: codes over many steps, what bounds them, and why it has no bound."""
