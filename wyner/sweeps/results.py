"""A sweep's results: additive rows in a CSV file, and what they add up to."""

import csv
import io
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import isnan, log2
from operator import itemgetter
from pathlib import Path
from typing import IO, Final

from protocol.statistics import (
    Interval,
    bits_left,
    mean_over_runs,
    mean_sequence,
    normal_mean,
    share_over_runs,
    wilson,
)
from runtime.files import PUBLIC_FILE, read_regular, refuse_irregular, write_atomically
from wyner.sweeps.code import loop_version
from wyner.sweeps.grid import Point, Row, SweepError, canonical

COUNTS: Final = ("tested", "agreements", "message_symbols", "mistaken")
SUMS: Final = ("state_cost", "state_cost_squares", "input_effort", "input_effort_squares")
REALS: Final = ("period_s", *SUMS)
"""Columns that are no whole numbers."""
FIXED: Final = ("task", "version", "scenario", "variant")
MEASURED: Final = (
    "period_s",
    "candidates",
    "steps",
    "seed",
    "first_run",
    "runs",
    *COUNTS,
    *SUMS,
    "runs_by_symbols",
    "runs_by_agreed",
)
"""Columns of a row; the fields of the grid stand between FIXED and MEASURED."""
BY_RUN: Final = "runs_by_agreed"
"""The column that says how many runs had how many of how many, as ``23/25:4``: agreed steps of
those tested."""
TAPPED_BY_RUN: Final = ("runs_by_keys", "runs_by_messages")
"""The same of each eavesdropper: keys known of those agreed, messages read of those delivered."""
TAPPED: Final = ("agreed", "right", "known", "delivered", "read", "key_blocks", "key_bits")
"""Columns of each eavesdropper, after MEASURED: keys agreed and, of these, named right at once, and
known at once up to one relabelling of the symbols a run (:mod:`protocol.relabelling`);
messages that the plant had whole and, of these, those that she had; key blocks and the bits of
their rows that she holds, where she goes for keys. Named ``tap.NAME.right``."""


def tap_columns(names: Iterable[str]) -> tuple[str, ...]:
    """The columns of the eavesdroppers of these names."""
    return tuple(f"tap.{name}.{c}" for name in names for c in (*TAPPED, *TAPPED_BY_RUN))


def taps_in(row: Row) -> list[str]:
    """The eavesdroppers of a row, by its columns."""
    end = f".{TAPPED[0]}"
    return [c[4 : -len(end)] for c in row if c.startswith("tap.") and c.endswith(end)]


class Results:
    """A CSV file of rows, appended a line at a time by one process.

    Parameters
    ----------
    path : Path
    fields : sequence of str
        The grid's.
    resume : bool
        Go on with a file that is there.
    taps : sequence of str
        Names of the eavesdroppers that listen.

    Raises
    ------
    SweepError
        When the file is there and ``resume`` is not given, or it is no sweep's, another sweep's or
        another version's, or another process writes it. It is then left as it is.
    """

    def __init__(
        self, path: Path, fields: Sequence[str], resume: bool, taps: Sequence[str] = ()
    ) -> None:
        self.path = path
        self.columns = (*FIXED, *fields, *MEASURED, *tap_columns(taps))
        self.rows: list[Row] = []
        path.parent.mkdir(parents=True, exist_ok=True)
        refuse_irregular(path)
        try:
            self._file: IO[bytes] = path.open("a+b" if resume else "x+b")
        except FileExistsError:
            raise SweepError(
                f"{path}: exists; --resume goes on with it, --output names another"
            ) from None
        try:
            self._take_up()
        except BaseException:
            self._file.close()
            raise

    def _take_up(self) -> None:
        """Read what is there; a torn last line is cut off once the file is known to be ours."""
        import fcntl

        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise SweepError(f"{self.path}: another process is writing it") from None
        self._file.seek(0)
        data = self._file.read()
        header = _line(self.columns)
        if data[: len(header)] != header[: len(data)]:
            raise SweepError(
                f"{self.path}: its columns are not this sweep's; --output names another"
            )
        whole = data[: data.rfind(b"\n") + 1]
        self.rows = _numbers(self.path, _table(self.path, whole))
        foreign = sorted({r["version"] for r in self.rows} - {loop_version()})
        if foreign:
            raise SweepError(
                f"{self.path}: has rows of code version {foreign[0]}, this is {loop_version()}; "
                "--output names another file"
            )
        self._file.truncate(len(whole))
        if not whole:
            self._write(self.columns)

    def _write(self, values: Sequence[object]) -> None:
        self._file.write(_line(values))
        self._file.flush()

    def add(self, point: Point, measured: Row) -> Row:
        """Append one row; returns it as a reader will see it."""
        row = {
            "task": point.task,
            "version": loop_version(),
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


def _line(values: Sequence[object]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(values)
    return text.getvalue().encode()


def key_of(row: Row) -> tuple[str, str, str]:
    """Scenario, variant and task: the rows of one point share them."""
    return row["scenario"], row["variant"], row["task"]


def read_table(path: Path) -> list[Row]:
    """The rows of a data file with a header, as text.

    Raises
    ------
    SweepError
        When the file cannot be read, has no rows, or its last line is torn.
    """
    try:
        data = read_regular(path)
    except OSError as error:
        raise SweepError(f"{path}: cannot be read: {error.strerror}") from None
    if not data.endswith(b"\n"):
        raise SweepError(f"{path}: {'its last line is torn' if data else 'is empty'}")
    rows = _table(path, data)
    if not rows:
        raise SweepError(f"{path}: has no rows")
    return rows


def _table(path: Path, data: bytes) -> list[Row]:
    try:
        text = data.decode()
        if not "".join(text.splitlines()).isprintable():
            raise csv.Error
        rows: list[Row] = list(csv.DictReader(io.StringIO(text, newline="")))
    except (UnicodeDecodeError, csv.Error):
        raise SweepError(f"{path}: is not CSV text") from None
    for number, row in enumerate(rows, start=2):
        if None in row or None in row.values():
            raise SweepError(f"{path}: line {number}: expected as many cells as the header has")
    return rows


def read_rows(path: Path) -> list[Row]:
    """The rows of a results file, with numbers as numbers; a grid field stays JSON text.

    Raises
    ------
    SweepError
        When the file cannot be read, has no rows, or a row is wrong or stands there twice.
    """
    return _numbers(path, read_table(path))


def _numbers(path: Path, rows: list[Row]) -> list[Row]:
    for number, row in enumerate(rows, start=2):
        counted = {}
        try:
            for name in (*MEASURED, *tap_columns(taps_in(row))):
                if name == "runs_by_symbols":
                    counted[name] = sum(histogram_of(row[name]).values())
                elif name.rpartition(".")[2] in (BY_RUN, *TAPPED_BY_RUN):
                    counted[name] = sum(pairs_of(row[name]).values())
                else:
                    row[name] = float(row[name]) if name in REALS else int(row[name])
        except (KeyError, ValueError):
            raise SweepError(f"{path}: line {number}: {name}: expected a number") from None
        for name, runs in counted.items():
            if runs != row["runs"]:
                raise SweepError(f"{path}: line {number}: {name}: expected {row['runs']} runs")
    try:
        summarise(rows)
    except SweepError as error:
        raise SweepError(f"{path}: {error}") from None
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
    taps : dict
        For each eavesdropper the counts of `TAPPED`.
    pairs : dict
        For each share how many runs had how many of how many.
    """

    first: Row
    runs: int
    counts: dict[str, int]
    sums: dict[str, float]
    histogram: dict[int, int]
    taps: dict[str, dict[str, int]]
    pairs: dict[str, dict[tuple[int, int], int]]

    @property
    def _scale(self) -> float:
        row = self.first
        return float(log2(row["candidates"]) / (row["steps"] * row["period_s"]))

    @property
    def rate(self) -> Interval:
        """Bits a second of plant time, with the bootstrap interval over runs."""
        return mean_over_runs(self.histogram).scaled(self._scale)

    @property
    def rate_at_every_look(self) -> Interval:
        """The same with limits that hold at every look: where runs are added until they fit."""
        return mean_sequence(self.histogram).scaled(self._scale)

    @property
    def costs(self) -> dict[str, Interval]:
        """Mean squares a step of the state and of the input, over runs: what control costs."""
        return {
            name: normal_mean(self.sums[name], self.sums[f"{name}_squares"], self.runs)
            for name in ("state_cost", "input_effort")
        }

    @property
    def secret(self) -> float | None:
        """Bits a second that the strongest eavesdropper leaves at most; None: none was run."""
        size, rate = self.first["candidates"], self.rate
        most = rate.high if rate.known else rate.value
        left = [
            bits_left(1, size, wilson(counts["known"], counts["agreed"])).high
            for counts in self.taps.values()
            if counts["agreed"]
        ]
        return most * min(left) / float(log2(size)) if left else None

    @property
    def shares(self) -> dict[str, Interval]:
        """Steps that agreed, and of each eavesdropper keys known and messages read, over runs."""
        return {name: share_over_runs(Counter(p).elements()) for name, p in self.pairs.items()}


def histogram_of(text: str) -> dict[int, int]:
    """The column ``runs_by_symbols``, read."""
    pairs = (pair.split(":") for pair in text.split())
    return {int(value): int(runs) for value, runs in pairs}


def pairs_of(text: str) -> dict[tuple[int, int], int]:
    """A column of :data:`BY_RUN` or :data:`TAPPED_BY_RUN`, read."""
    found: Counter[tuple[int, int]] = Counter()
    for part in text.split():
        pair, runs = part.split(":")
        right, of = pair.split("/")
        found[int(right), int(of)] += int(runs)
    return dict(found)


def pairs_text(pairs: Iterable[tuple[int, int]]) -> str:
    """The successes and trials of each run, as such a column holds them."""
    counted = sorted(Counter(pairs).items())
    return " ".join(f"{right}/{of}:{runs}" for (right, of), runs in counted)


def _pairs(rows: Sequence[Row]) -> dict[str, dict[tuple[int, int], int]]:
    """Of each share how many runs had how many of how many."""
    columns = {"agreed": BY_RUN}
    for name in taps_in(rows[0]):
        for share, column in zip(("keys known", "messages read"), TAPPED_BY_RUN, strict=True):
            columns[f"{name} {share}"] = f"tap.{name}.{column}"
    return {
        share: dict(sum((Counter(pairs_of(row[column])) for row in rows), Counter()))
        for share, column in columns.items()
    }


def summarise(rows: Iterable[Row]) -> list[Summary]:
    """Add up the rows of each point, in order of appearance.

    Raises
    ------
    SweepError
        When a run is in two rows of one point.
    """
    found: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        found.setdefault(key_of(row), []).append(row)
    out = []
    for same in found.values():
        ordered = sorted(same, key=itemgetter("first_run"))
        for one, following in pairwise(ordered):
            if following["first_run"] < one["first_run"] + one["runs"]:
                shown = ", ".join(part for part in key_of(one) if part)
                raise SweepError(f"{shown}: run {following['first_run']} stands there twice")
        histogram: Counter[int] = Counter()
        for row in same:
            histogram.update(histogram_of(row["runs_by_symbols"]))
        out.append(
            Summary(
                first=same[0],
                runs=sum(row["runs"] for row in same),
                counts={name: sum(row[name] for row in same) for name in COUNTS},
                sums={name: sum(row[name] for row in same) for name in SUMS},
                histogram=histogram,
                taps={
                    name: {c: sum(row[f"tap.{name}.{c}"] for row in same) for c in TAPPED}
                    for name in taps_in(same[0])
                },
                pairs=_pairs(same),
            )
        )
    return out


def ready_rows(
    summaries: Sequence[Summary], fields: Sequence[str], *, stopped: bool = False
) -> list[Row]:
    """One row a point with what people plot: rates, shares, and the ends of their 95 % intervals.

    Intervals are over runs; where the sweep has a stopping rule, the rate's hold at every look. A
    cell is empty where there is no interval.
    """

    def cell(value: float) -> float | str:
        return "" if isnan(value) else value

    rows = []
    for s in summaries:
        rate = s.rate_at_every_look if stopped else s.rate
        row: Row = {
            "scenario": s.first["scenario"],
            "variant": s.first["variant"],
            **{name: s.first[name] for name in fields},
            "runs": s.runs,
            "steps": s.first["steps"],
            "bits_per_second": rate.value,
            "bits_per_second_low": cell(rate.low),
            "bits_per_second_high": cell(rate.high),
            "secret_bits_per_second_at_most": "" if s.secret is None else s.secret,
        }
        for name, cost in s.costs.items():
            row[name] = cell(cost.value)
            row[f"{name}_low"] = cell(cost.low)
            row[f"{name}_high"] = cell(cost.high)
        for name, share in s.shares.items():
            row[name] = cell(share.value)
            row[f"{name} low"] = cell(share.low)
            row[f"{name} high"] = cell(share.high)
        rows.append(row)
    return rows


def write_ready(path: Path, rows: Sequence[Row]) -> None:
    """Write the rows of `ready_rows` as CSV."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_atomically(path, text.getvalue().encode(), PUBLIC_FILE)


def fields_in(rows: Sequence[Row]) -> list[str]:
    """The grid's fields, by the columns of a results file."""
    known = {*FIXED, *MEASURED, *tap_columns(taps_in(rows[0]))}
    return [name for name in rows[0] if name not in known]
