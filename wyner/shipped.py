"""Data that comes with the package besides its scenarios: sweeps, and the figures' data."""

from pathlib import Path
from typing import Final

_HERE: Final = Path(__file__).resolve().parent
_DOCS: Final = _HERE.parent / "docs"
IN_CHECKOUT: Final = (_DOCS / "data").is_dir()
"""Whether this is the source tree, and not an installed copy."""

SWEEPS: Final = _HERE / "sweeps"

DATA: Final = _DOCS / "data" if IN_CHECKOUT else _HERE / "studies" / "data"
"""The figures' data; a wheel carries a copy of docs/data."""

FIGURES_FOLDER: Final = _DOCS / "figures" if IN_CHECKOUT else Path("figures")
"""Where figures are drawn: in a checkout the documents', else a folder of the user's."""
