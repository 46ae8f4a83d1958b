"""Data that comes with the package: scenarios and sweeps."""

from pathlib import Path
from typing import Final

SCENARIOS: Final = Path(__file__).resolve().parent / "scenarios"
SWEEPS: Final = Path(__file__).resolve().parent / "sweeps"
