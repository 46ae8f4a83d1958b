"""What is measured for the documents, and their figures: no part of what is installed."""

from pathlib import Path
from typing import Final

_DOCS: Final = Path(__file__).resolve().parents[1] / "docs"

DATA: Final = _DOCS / "data"
"""What the studies measured."""

FIGURES_FOLDER: Final = _DOCS / "figures"
