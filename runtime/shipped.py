"""The scenarios that come with the package."""

from pathlib import Path
from typing import Final

SCENARIOS: Final = Path(__file__).resolve().parent / "scenarios"


def scenario_file_of(text: str) -> Path:
    """The file itself, or the shipped scenario of that name."""
    shipped = SCENARIOS / f"{text}.toml"
    return shipped if not Path(text).is_file() and shipped.is_file() else Path(text)
