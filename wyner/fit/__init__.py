"""``wyner fit``: a model and a D_c for a plant that is known by its readings only."""
