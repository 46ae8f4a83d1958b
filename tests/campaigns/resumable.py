"""A campaign that goes on where it stopped: what it has done so far, in a file of results."""

import json
import sys
from collections import Counter
from pathlib import Path
from typing import Any

from runtime.files import write_atomically
from wyner.sweeps.code import code_version


class Results:
    """What was done, counted and found wrong; other code begins anew.

    Parameters
    ----------
    path : Path
    start : dict
        What is kept beside ``version``, ``counts`` and ``wrong``, as it is at the beginning.
    """

    def __init__(self, path: Path, start: dict[str, Any]) -> None:
        self._path = path
        version = code_version("tests.campaigns.kills", without=())
        self.done: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
        if self.done.get("version") != version:
            self.done = {"version": version, **start, "counts": {}, "wrong": []}

    def add(self, name: str, counts: Counter[str], wrong: list[str]) -> None:
        """Count what one part of it came to, and say what was wrong."""
        self.done["counts"] = dict(Counter(self.done["counts"]) + counts)
        if wrong:
            self.done["wrong"].append([name, *wrong])
            print(f"\r{name}: {wrong}")

    def save(self, told: str) -> None:
        """Write the file, and a line of progress."""
        write_atomically(self._path, json.dumps(self.done, indent=1).encode())
        print(f"\r{told}", end="", file=sys.stderr, flush=True)

    @property
    def exit_code(self) -> int:
        """1 when something was wrong."""
        return 1 if self.done["wrong"] else 0
