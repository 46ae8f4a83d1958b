"""How far apart candidates are kept; loads no numerics."""

from typing import Final

CERTAIN: Final = 2.0
"""Spacing, in half-lengths of D_c along the input, from which an agreement is certain."""
