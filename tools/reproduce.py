"""Runs the page for reviewers, a row at a time: ``python -m tools.reproduce --longest 2``.

A row holds when its command ends with code 0, prints all that stands as code in the row's column
"expected", and writes the same rows as the file that this column links to. Where its tolerance is
"FIELD at least N", the JSON object that it prints must have such a field. What the commands write
goes to ``build/reproduced``, emptied first.
"""

import argparse
import csv
import json
import math
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final, NamedTuple

from runtime.errors import DONE, FAILED

ROOT: Final = Path(__file__).resolve().parents[1]
PAGE: Final = ROOT / "docs" / "reproduce.md"
WRITTEN: Final = Path("build", "reproduced")

SLOWER: Final = 10.0
"""So many times its minutes a command may take: other machines are slower."""

OF_THE_CODE: Final = ("task", "version")
"""Columns that change with the code and not with what is measured."""

CLOSE: Final = 1e-9
"""Relative difference of two numbers that are the same on another processor."""

_ROW: Final = re.compile(r"^\| ([^|]+) \| `([^`|]+)` \| ([^|]+) \| ([^|]+) \| ([^|]*)\|$", re.M)
_LEAST: Final = re.compile(r"(\w+) at least ([\d.]+)")


class ReviewRow(NamedTuple):
    """What the page claims, and how it can be seen."""

    claim: str
    command: str
    minutes: float
    expected: str
    tolerance: str = ""

    @property
    def printed(self) -> list[str]:
        """What the command must print."""
        return re.findall(r"`([^`]+)`", self.expected)

    @property
    def shipped(self) -> str:
        """The file of ``docs/data`` whose rows the command must write, or nothing."""
        found = re.search(r"\]\(data/([^)]+)\)", self.expected)
        return found[1] if found else ""

    @property
    def least(self) -> tuple[str, float] | None:
        """A field of the JSON object that the command prints, and the least that it may be."""
        found = _LEAST.search(self.tolerance)
        return (found[1], float(found[2])) if found else None


def rows(text: str) -> list[ReviewRow]:
    """The rows of a page; "hours" are without a limit.

    Raises
    ------
    ValueError
        When a row's minutes are no number.
    """
    return [
        ReviewRow(
            claim, command, math.inf if minutes == "hours" else float(minutes), expected, tolerance
        )
        for claim, command, minutes, expected, tolerance in _ROW.findall(text)
    ]


def same_rows(made: Path, shipped: Path) -> bool:
    """Whether two tables say the same, the columns apart that name the code."""
    with made.open(newline="") as one, shipped.open(newline="") as other:
        both = [list(csv.DictReader(file)) for file in (one, other)]
    return len(both[0]) == len(both[1]) and all(
        mine.keys() == theirs.keys()
        and all(same(mine[name], theirs[name]) for name in mine if name not in OF_THE_CODE)
        for mine, theirs in zip(*both, strict=True)
    )


def same(one: str, other: str) -> bool:
    """Whether two entries of a table are the same, also where another processor made one."""
    try:
        return math.isclose(float(one), float(other), rel_tol=CLOSE, abs_tol=CLOSE)
    except ValueError:
        return one == other


def differs(row: ReviewRow) -> str:
    """What came out otherwise than the page says, in a line; empty when nothing did."""
    programs = Path(sys.executable).parent
    environment = os.environ | {"PATH": f"{programs}{os.pathsep}{os.environ['PATH']}"}
    try:
        ended = subprocess.run(
            shlex.split(row.command),
            cwd=ROOT,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=None if math.isinf(row.minutes) else 60 * SLOWER * row.minutes,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"not done after {SLOWER * row.minutes:g} minutes"
    if ended.returncode:
        last = ended.stdout.rstrip().rpartition("\n")[2]
        return f"ended with code {ended.returncode}: {last}"
    words = " ".join(ended.stdout.split())
    lacking = [printed for printed in row.printed if printed not in words]
    if lacking:
        return f"did not print {', '.join(lacking)}"
    if row.least is not None:
        field, least = row.least
        told = next((line for line in ended.stdout.splitlines() if line.startswith("{")), "{}")
        value = json.loads(told).get(field)
        if value is None or value < least:
            return f"{field}: got {value}, expected at least {least:g}"
    if row.shipped:
        made = ROOT / WRITTEN / row.shipped
        if not made.is_file() or not same_rows(made, ROOT / "docs" / "data" / row.shipped):
            return f"{WRITTEN / row.shipped} is not as docs/data/{row.shipped}"
    return ""


def maker_of(row: ReviewRow, page: Iterable[ReviewRow]) -> ReviewRow | None:
    """The row whose command makes the run that this row's command looks at, if it looks at one."""
    looked_at = row.command.split()[-1]
    makers = (other for other in page if f"--run-dir {looked_at}" in other.command)
    return next((maker for maker in makers if maker is not row), None)


def chosen_of(page: Iterable[ReviewRow], longest: float, only: str) -> list[ReviewRow]:
    """Rows of at most so many minutes whose command has this, each with the row that it needs."""
    page = list(page)
    makers = {row: maker_of(row, page) for row in page}
    short = [row for row in page if max(r.minutes for r in (row, makers[row]) if r) <= longest]
    wanted = [row for row in short if only in row.command]
    needed = {makers[row] for row in wanted}
    return [row for row in short if row in wanted or row in needed]


def reproduced(chosen: Iterable[ReviewRow]) -> Iterator[tuple[ReviewRow, str, float]]:
    """Each row, what differed, and the minutes that it took."""
    shutil.rmtree(ROOT / WRITTEN, ignore_errors=True)
    for row in chosen:
        began = time.monotonic()
        why = differs(row)
        yield row, why, (time.monotonic() - began) / 60


def main(argv: list[str] | None = None) -> int:
    """Run the rows, and say of each whether it holds; 1 when one does not."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--longest", type=float, default=float("inf"), metavar="MINUTES")
    parser.add_argument("--only", default="", metavar="TEXT", help="rows whose command has this")
    args = parser.parse_args(argv)
    page = rows(PAGE.read_text(encoding="utf-8"))
    chosen = chosen_of(page, args.longest, args.only)
    held = 0
    for row, why, minutes in reproduced(chosen):
        held += not why
        print(f"{'differs' if why else 'holds':8}{minutes:6.1f} min  {row.command}", flush=True)
        if why:
            print(f"{'':19}{why}", flush=True)
    print(f"{held} of {len(chosen)} rows hold; {len(page) - len(chosen)} not run")
    return DONE if held == len(chosen) else FAILED


if __name__ == "__main__":
    sys.exit(main())
