"""Where what takes long to compute is kept: designs and tables of laws."""

import os
from pathlib import Path


def cache_folder(kind: str) -> Path:
    """``$XDG_CACHE_HOME/wyner/KIND``, else ``~/.cache/wyner/KIND``.

    A user without a home is given a folder that cannot be made: nothing is kept.
    """
    base = os.environ.get("XDG_CACHE_HOME")
    if base and Path(base).is_absolute():
        return Path(base) / "wyner" / kind
    try:
        home = Path.home()
    except RuntimeError:
        home = Path(os.devnull)
    return home / ".cache" / "wyner" / kind
