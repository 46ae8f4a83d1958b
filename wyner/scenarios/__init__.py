"""Plants as files, and in :mod:`wyner.scenarios.plants` the functions that some of them name."""
