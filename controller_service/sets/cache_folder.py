"""Where computed designs, and the tables of laws, are kept from run to run."""

import os
from pathlib import Path


def default_folder() -> Path:
    """``$XDG_CACHE_HOME/wyner/designs``, else ``~/.cache/wyner/designs``."""
    base = os.environ.get("XDG_CACHE_HOME")
    root = Path(base) if base and Path(base).is_absolute() else Path.home() / ".cache"
    return root / "wyner" / "designs"
