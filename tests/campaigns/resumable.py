"""A campaign that goes on where it stopped: what it has done so far, in a file of results."""

import argparse
import json
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
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


def options(about: str | None, results: str) -> argparse.ArgumentParser:
    """The options that every such campaign has."""
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--results", type=Path, default=Path(results))
    return parser


def seeds(
    one_run: Callable[[int, Path], tuple[Counter[str], list[str]]],
    results: Results,
    count: int,
    seconds: float,
) -> int:
    """Run seed after seed, each in a folder of its own; 1 when something was wrong."""
    until = time.monotonic() + seconds
    done = results.done
    while done["runs"] < count and time.monotonic() < until:
        seed = done["runs"]
        with tempfile.TemporaryDirectory() as folder:
            results.add(f"seed {seed}", *one_run(seed, Path(folder)))
        done["runs"] += 1
        if done["runs"] % 20 == 0:
            results.save(f"{done['runs']:,} of {count:,}")
    results.save(f"{done['runs']:,} of {count:,}")
    return results.exit_code
