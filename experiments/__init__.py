"""Experiments: the loop over many runs, sweeps, figures, benchmarks and their references."""
