"""A run's folder: one reader of it, and what is made of a run."""
