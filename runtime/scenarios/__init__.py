"""Plants as files, and in :mod:`runtime.scenarios.plants` the functions that some of them name."""
