"""A sweep's results: additive rows in a CSV file, and what they add up to."""

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import log2
from pathlib import Path
from typing import Final

from experiments.grid import Point, Row, SweepError, canonical, code_version
from experiments.statistics import Interval, bootstrap_mean

COUNTS: Final = ("tested", "agreements", "message_symbols", "mistaken", "nearest")
SUMS: Final = ("state_cost", "state_cost_squares", "input_effort", "input_effort_squares")
FIXED: Final = ("task", "version", "scenario", "variant")
MEASURED: Final = (
    *("period_s", "candidates", "steps", "seed", "first_run", "runs"),
    *COUNTS,
    *SUMS,
    "runs_by_symbols",
)
"""Columns of a row; the fields of the grid stand between FIXED and MEASURED."""


class Results:
    """A CSV file of rows, appended a line at a time.

    Parameters
    ----------
    path : Path
    fields : sequence of str
        The grid's.
    resume : bool
        Go on with a file that is there.

    Raises
    ------
    SweepError
        When the file is there and ``resume`` is not given, or it is another sweep's, or another
        version's.
    """

    def __init__(self, path: Path, fields: Sequence[str], resume: bool) -> None:
        self.path = path
        self.columns = (*FIXED, *fields, *MEASURED)
        self.rows: list[Row] = []
        if path.exists():
            if not resume:
                raise SweepError(
                    f"{path}: exists; --resume goes on with it, --output names another"
                )
            self._take_up()
        path.parent.mkdir(parents=True, exist_ok=True)
        fresh = not path.exists() or path.stat().st_size == 0
        self._file = path.open("a", encoding="utf-8", newline="")
        if fresh:
            self._write(self.columns)

    def _take_up(self) -> None:
        """Read what is there; a torn last line is cut off."""
        data = self.path.read_bytes()
        whole = data[: data.rfind(b"\n") + 1]
        if len(whole) < len(data):
            with self.path.open("r+b") as file:
                file.truncate(len(whole))
        if not whole:
            return
        rows = read_rows(self.path)
        header = tuple(next(csv.reader(io.StringIO(whole.decode("utf-8")))))
        if header != self.columns:
            raise SweepError(
                f"{self.path}: its columns are not this sweep's; --output names another"
            )
        foreign = sorted({r["version"] for r in rows} - {code_version()})
        if foreign:
            raise SweepError(
                f"{self.path}: has rows of code version {foreign[0]}, this is {code_version()}; "
                "--output names another file"
            )
        self.rows = rows

    def _write(self, values: Sequence[object]) -> None:
        line = io.StringIO()
        csv.writer(line, lineterminator="\n").writerow(values)
        self._file.write(line.getvalue())
        self._file.flush()

    def add(self, point: Point, measured: Row) -> Row:
        """Append one row; returns it as a reader will see it."""
        row = {
            "task": point.task,
            "version": code_version(),
            "scenario": point.scenario.name,
            "variant": point.variant,
            **{name: canonical(value) for name, value in point.fields.items()},
            **measured,
        }
        self._write([row[c] for c in self.columns])
        self.rows.append(row)
        return row

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def read_rows(path: Path) -> list[Row]:
    """The rows of a results file, with numbers as numbers; a grid field stays JSON text.

    Raises
    ------
    SweepError
        When the file cannot be read or a row has a wrong number.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows: list[Row] = list(csv.DictReader(file))
    except OSError as error:
        raise SweepError(f"{path}: cannot be read: {error.strerror}") from None
    for number, row in enumerate(rows, start=2):
        try:
            for name in MEASURED:
                if name in ("period_s", *SUMS):
                    row[name] = float(row[name])
                elif name != "runs_by_symbols":
                    row[name] = int(row[name])
        except (KeyError, TypeError, ValueError):
            raise SweepError(f"{path}: line {number}: {name}: expected a number") from None
    return rows


@dataclass(frozen=True)
class Summary:
    """All rows of one point, added up.

    Parameters
    ----------
    first : dict
        The first of the rows: task, fields and all that they share.
    runs : int
    counts, sums : dict
    histogram : dict
        How many runs carried each number of message symbols.
    """

    first: Row
    runs: int
    counts: dict[str, int]
    sums: dict[str, float]
    histogram: dict[int, int]

    @property
    def rate(self) -> Interval:
        """Bits a second of plant time, with the bootstrap interval over runs."""
        row = self.first
        bits = log2(row["candidates"]) / (row["steps"] * row["period_s"])
        return bootstrap_mean(self.histogram).scaled(bits)


def histogram_of(text: str) -> dict[int, int]:
    """The column ``runs_by_symbols``, read."""
    pairs = (pair.split(":") for pair in text.split())
    return {int(value): int(runs) for value, runs in pairs}


def summarise(rows: Iterable[Row]) -> list[Summary]:
    """Add up the rows of each point (by scenario, variant and task), in order of appearance."""
    found: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        found.setdefault((row["scenario"], row["variant"], row["task"]), []).append(row)
    out = []
    for same in found.values():
        histogram: dict[int, int] = {}
        for row in same:
            for value, runs in histogram_of(row["runs_by_symbols"]).items():
                histogram[value] = histogram.get(value, 0) + runs
        out.append(
            Summary(
                first=same[0],
                runs=sum(row["runs"] for row in same),
                counts={name: sum(row[name] for row in same) for name in COUNTS},
                sums={name: sum(row[name] for row in same) for name in SUMS},
                histogram=histogram,
            )
        )
    return out
