"""A run as a flat table: one row a step, one column a number, the truth beside it where asked."""

import csv
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from types import NoneType
from typing import IO, Any, Final

from tap_service.capture.reading import CaptureReader
from tap_service.capture.transcript import Transcript, Transition
from wyner.runs.run import Run

Row = dict[str, Any]


Truth = Callable[[str, int], Row]


def truth_of(run: Run) -> Truth:
    """What the plant of a run knew of a step, given by session and k.

    Coin, applied input, role, key, message symbol and gauges; empty where none was made.

    Raises
    ------
    ScoreError
        When the plant's trace cannot be read.
    """
    from wyner.runs.score.score import the_plant
    from wyner.runs.trace import Places

    trace = the_plant(run)
    places, rows = Places(trace), trace.steps

    def of(session: str, k: int) -> Row:
        place = places.of(session, k)
        if place < 0 or rows[place]["j"] < 0:
            return {}
        row = rows[place]
        return {
            "coin": int(row["coin"]),
            **_numbered("u_", row["u"].tolist()),
            "role": "message" if row["message"] else "test",
            "key": int(row["symbol"]),
            "message_symbol": int(row["message_symbol"]),
            **_numbered("gauge_", row["gauges"].tolist(), first=0),
        }

    return of


def step_rows(reader: CaptureReader, truth: Truth | None) -> Iterator[Row]:
    """One row a step of a capture, repeats put together; what was not heard is empty.

    Columns: ``session``, ``k``, ``x_1`` ..., ``u0_1`` ... (candidate 0, input 1), ``cipher``,
    ``x_next_1`` ..., and with ``truth`` those of :func:`truth_of`.
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
    return row if truth is None else row | truth(t.session, t.k)


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
