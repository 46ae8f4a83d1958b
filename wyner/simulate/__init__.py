"""The closed loop without a network: one process, and many runs at once."""
