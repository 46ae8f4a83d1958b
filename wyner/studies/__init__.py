"""Experiments: sweeps, the secrecy study, and the figures."""
