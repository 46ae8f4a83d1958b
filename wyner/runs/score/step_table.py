"""A run as a flat table: one row a step, one column a number, the truth beside it where asked."""

import csv
from array import array
from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from types import NoneType
from typing import IO, Any, Final

from tap_service.capture.reading import CaptureReader
from tap_service.capture.transcript import Transcript, Transition
from wyner.runs.run import Run
from wyner.runs.score.score import feed_the_plant

Row = dict[str, Any]


class Truth:
    """What the plant knew of each step, in some 60 bytes each."""

    def __init__(self) -> None:
        self._sessions: dict[str, _Session] = {}

    def take(self, event: Mapping[str, Any]) -> None:
        """Keep a transition of the plant's trace; they come in rising steps."""
        if event["event"] == "transition":
            session = str(event["session"])
            if session not in self._sessions:
                self._sessions[session] = _Session(len(event["u"]), len(event["gauges"]))
            self._sessions[session].take(event)

    def of(self, session: str, k: int) -> Row:
        """Coin, applied input, role, key, message symbol and gauges; empty where none was made."""
        found = self._sessions.get(session)
        return {} if found is None else found.of(k)


class _Session:
    """The steps of one session, in columns."""

    def __init__(self, inputs: int, candidates: int) -> None:
        self._inputs, self._width = inputs, inputs + candidates
        self._k = array("q")
        self._symbols = array("h")  # coin, key and message symbol of a step after the other
        self._numbers = array("d")  # its input and gauges
        self._carries = bytearray()

    def take(self, event: Mapping[str, Any]) -> None:
        numbers = [*event["u"], *event["gauges"]]
        if len(numbers) != self._width:
            raise ValueError(f"k {event['k']}: expected {self._width} inputs and gauges")
        self._k.append(event["k"])
        self._symbols.extend((event["coin"], event["symbol"], event["message_symbol"]))
        self._numbers.extend(numbers)
        self._carries.append(event["role"] == "message")

    def of(self, k: int) -> Row:
        i = bisect_left(self._k, k)
        if i == len(self._k) or self._k[i] != k:
            return {}
        coin, key, message_symbol = self._symbols[3 * i : 3 * i + 3]
        numbers = self._numbers[self._width * i : self._width * (i + 1)].tolist()
        return {
            "coin": coin,
            **_numbered("u_", numbers[: self._inputs]),
            "role": "message" if self._carries[i] else "test",
            "key": key,
            "message_symbol": message_symbol,
            **_numbered("gauge_", numbers[self._inputs :], first=0),
        }


def truth_of(run: Run) -> Truth:
    """What the plant knew of each step of a run.

    Raises
    ------
    ScoreError
        When the plant's trace cannot be read.
    """
    found = Truth()
    feed_the_plant(run, found.take)
    return found


def step_rows(reader: CaptureReader, truth: Truth | None) -> Iterator[Row]:
    """One row a step of a capture, repeats put together; what was not heard is empty.

    Columns: ``session``, ``k``, ``x_1`` ..., ``u0_1`` ... (candidate 0, input 1), ``cipher``,
    ``x_next_1`` ..., and with ``truth`` those of `Truth.of`.
    """
    transcript = Transcript()
    for _, message in reader.records():
        for transition in transcript.hear(message):
            yield _row(transition, truth)
    for transition in transcript.flush():
        yield _row(transition, truth)


def _row(t: Transition, truth: Truth | None) -> Row:
    row: Row = {"session": t.session, "k": t.k, **_numbered("x_", t.x)}
    for i, u in enumerate(t.candidates or ()):
        row |= _numbered(f"u{i}_", u)
    row |= {"cipher": t.cipher, **_numbered("x_next_", t.x_next)}
    return row if truth is None else row | truth.of(t.session, t.k)


def _numbered(prefix: str, values: Sequence[float] | None, first: int = 1) -> Row:
    return {f"{prefix}{i}": v for i, v in enumerate(values or (), start=first)}


Rows = Callable[[], Iterable[Row]]
"""Rows that can be gone through again: once for their columns, and once to be written."""

AT_ONCE: Final = 10_000
"""Rows of a Parquet file that are in memory together."""


def write_csv(rows: Rows, out: IO[str]) -> int:
    """Write the rows under the columns of the fullest one; returns how many."""
    writer = csv.DictWriter(out, [*_columns(rows())], lineterminator="\n", restval="")
    writer.writeheader()
    count = 0
    for row in rows():
        writer.writerow(row)
        count += 1
    return count


def write_parquet(rows: Rows, path: Path) -> int:
    """Write the rows as Parquet; returns how many. Raises ImportError without pyarrow."""
    import pyarrow
    from pyarrow.parquet import ParquetWriter

    types = {int: pyarrow.int64(), float: pyarrow.float64(), str: pyarrow.string()}
    columns = {name: types.get(kind, pyarrow.null()) for name, kind in _columns(rows()).items()}
    schema, count = pyarrow.schema(columns.items()), 0
    with ParquetWriter(path, schema) as writer:
        every = iter(rows())
        while batch := list(islice(every, AT_ONCE)):
            table = {name: [row.get(name) for row in batch] for name in columns}
            writer.write_table(pyarrow.table(table, schema=schema))
            count += len(batch)
    return count


def _columns(rows: Iterable[Row]) -> dict[str, type]:
    """All columns with the type of their values, in the order of the row that has most."""
    fullest: Sequence[str] = ()
    kinds: dict[str, type] = {}
    for row in rows:
        if len(row) > len(fullest):
            fullest = list(row)
        for name, value in row.items():
            if kinds.get(name, NoneType) is NoneType:
                kinds[name] = type(value)
    return {name: kinds[name] for name in [*fullest, *sorted(kinds.keys() - set(fullest))]}
