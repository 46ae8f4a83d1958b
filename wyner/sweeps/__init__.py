"""Sweeps: a grid over fields of a scenario, its rows, and what they add up to."""

from pathlib import Path
from typing import Final

SWEEPS: Final = Path(__file__).resolve().parent
"""The sweeps that come with the package."""
