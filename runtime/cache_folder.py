"""Where what takes long to compute is kept: designs, tables of laws, counts of a language."""

import os
from pathlib import Path


def cache_folder(kind: str) -> Path:
    """``$XDG_CACHE_HOME/wyner/KIND``, else ``~/.cache/wyner/KIND``."""
    base = os.environ.get("XDG_CACHE_HOME")
    root = Path(base) if base and Path(base).is_absolute() else Path.home() / ".cache"
    return root / "wyner" / kind
