"""Guesses beside the truth: scores, reports, intervals."""
