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
    normal_mean,
    share_over_runs,
    wilson,
)
from runtime.files import PUBLIC_FILE, read_regular, refuse_irregular, write_atomically
from wyner.sweeps.code import loop_version
from wyner.sweeps.grid import Point, Row, SweepError, canonical

Spread = Counter[tuple[int, ...]]
"""How many runs had each number, or each number of another."""

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
TAPPED_BY_RUN: Final = ("runs_by_keys", "runs_by_messages")
SPREADS: Final = ("runs_by_symbols", "runs_by_agreed", *TAPPED_BY_RUN)
"""Columns that say how many runs had how many of how many, as ``23/25:4``: message symbols; agreed
steps of those tested; and of each eavesdropper keys known of those agreed, messages read of those
delivered."""
TAPPED: Final = ("agreed", "right", "known", "delivered", "read", "key_blocks", "key_bits")
"""Columns of each eavesdropper, after MEASURED and before :data:`TAPPED_BY_RUN`: keys agreed and
of these, named right at once, and known at once up to one relabelling of the symbols a run
(:mod:`protocol.relabelling`); messages that the plant had whole and, of these, those that she had;
key blocks and the bits of their rows that she holds, where she goes for keys. Named
``tap.NAME.right``."""


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
        self._file.write(_line([_cell(value) for value in values]))
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
        for name in (*MEASURED, *tap_columns(taps_in(row))):
            try:
                row[name] = value = _value(name, row[name])
            except (KeyError, ValueError):
                raise SweepError(f"{path}: line {number}: {name}: expected a number") from None
            if isinstance(value, Counter) and value.total() != row["runs"]:
                raise SweepError(f"{path}: line {number}: {name}: expected {row['runs']} runs")
    try:
        summarise(rows)
    except SweepError as error:
        raise SweepError(f"{path}: {error}") from None
    return rows


def _value(column: str, text: str) -> int | float | Spread:
    """A cell of a measured column."""
    if column.rpartition(".")[2] in SPREADS:
        found: Spread = Counter()
        for part in text.split():
            value, runs = part.split(":")
            found[tuple(map(int, value.split("/")))] += int(runs)
        return found
    return float(text) if column in REALS else int(text)


def _cell(value: object) -> object:
    """As :func:`_value` reads it."""
    if not isinstance(value, Counter):
        return value
    return " ".join(f"{'/'.join(map(str, v))}:{runs}" for v, runs in sorted(value.items()))


@dataclass(frozen=True)
class Summary:
    """All rows of one point, added up.

    Parameters
    ----------
    first : dict
        The first of the rows: task, fields and all that they share.
    total : dict
        By column, what adds up.
    """

    first: Row
    total: Row

    @property
    def runs(self) -> int:
        """How many there are."""
        return int(self.total["runs"])

    @property
    def counts(self) -> dict[str, int]:
        """The columns :data:`COUNTS`."""
        return {name: self.total[name] for name in COUNTS}

    @property
    def sums(self) -> dict[str, float]:
        """The columns :data:`SUMS`."""
        return {name: self.total[name] for name in SUMS}

    @property
    def taps(self) -> dict[str, dict[str, int]]:
        """For each eavesdropper the counts of :data:`TAPPED`."""
        return {
            name: {column: self.total[f"tap.{name}.{column}"] for column in TAPPED}
            for name in taps_in(self.first)
        }

    @property
    def rate(self) -> Interval:
        """Bits a second of plant time, with the bootstrap interval over runs."""
        row, symbols = self.first, self.total["runs_by_symbols"]
        scale = float(log2(row["candidates"]) / (row["steps"] * row["period_s"]))
        return mean_over_runs({v: runs for (v,), runs in symbols.items()}).scaled(scale)

    @property
    def costs(self) -> dict[str, Interval]:
        """Mean squares a step of the state and of the input, over runs: what control costs."""
        return {
            name: normal_mean(self.total[name], self.total[f"{name}_squares"], self.runs)
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
        columns = {"agreed": "runs_by_agreed"}
        for name in taps_in(self.first):
            for share, column in zip(("keys known", "messages read"), TAPPED_BY_RUN, strict=True):
                columns[f"{name} {share}"] = f"tap.{name}.{column}"
        pairs = {share: self.total[column].elements() for share, column in columns.items()}
        return {share: share_over_runs(list(them)) for share, them in pairs.items()}


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
        first, *others = same
        additive = ("runs", *COUNTS, *SUMS, *SPREADS[:2], *tap_columns(taps_in(first)))
        total = {name: sum((row[name] for row in others), first[name]) for name in additive}
        out.append(Summary(first, total))
    return out


def ready_rows(summaries: Sequence[Summary], fields: Sequence[str]) -> list[Row]:
    """One row a point with what people plot: rates, shares, and the ends of their 95 % intervals.

    Intervals are over runs. A cell is empty where there is none.
    """

    def cells(name: str, found: Interval, before: str = "_") -> Row:
        ends = {"": found.value, f"{before}low": found.low, f"{before}high": found.high}
        return {f"{name}{end}": "" if isnan(v) else v for end, v in ends.items()}

    rows = []
    for s in summaries:
        row: Row = {
            "scenario": s.first["scenario"],
            "variant": s.first["variant"],
            **{name: s.first[name] for name in fields},
            "runs": s.runs,
            "steps": s.first["steps"],
            **cells("bits_per_second", s.rate),
            "secret_bits_per_second_at_most": "" if s.secret is None else s.secret,
        }
        for name, cost in s.costs.items():
            row |= cells(name, cost)
        for name, share in s.shares.items():
            row |= cells(name, share, before=" ")
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
