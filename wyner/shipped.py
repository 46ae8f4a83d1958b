"""Data that comes with the package besides its scenarios: sweeps."""

from pathlib import Path
from typing import Final

SWEEPS: Final = Path(__file__).resolve().parent / "sweeps"
