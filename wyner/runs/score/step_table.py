"""A run as a flat table: one row a step, one column a number, the truth beside it where asked."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

from runtime.recording import TraceError
from tap_service.capture.reading import CaptureReader
from tap_service.capture.transcript import Transcript, Transition
from wyner.runs.run import Run
from wyner.runs.score.by_step import Step
from wyner.runs.score.score import ScoreError

Row = dict[str, Any]


def truth_by_step(run: Run) -> dict[Step, Row]:
    """What the plant knew of each step: coin, applied input, role, key, message symbol, gauges.

    Raises
    ------
    ScoreError
        When the plant's trace cannot be read.
    """
    found: dict[Step, Row] = {}

    def take(event: Mapping[str, Any]) -> None:
        if event["event"] == "transition":
            found[str(event["session"]), int(event["k"])] = {
                "coin": event["coin"],
                **_numbered("u_", event["u"]),
                "role": event["role"],
                "key": event["symbol"],
                "message_symbol": event["message_symbol"],
                **_numbered("gauge_", event["gauges"], first=0),
            }

    try:
        run.feed("plant", take)
    except TraceError as error:
        raise ScoreError(str(error)) from None
    return found


def step_rows(reader: CaptureReader, truth: Mapping[Step, Row] | None) -> Iterator[Row]:
    """One row a step of a capture, repeats put together; what was not heard is empty.

    Columns: ``session``, ``k``, ``x_1`` ..., ``u0_1`` ... (candidate 0, input 1), ``cipher``,
    ``x_next_1`` ..., and with ``truth`` those of `truth_by_step`.
    """
    transcript = Transcript()
    for _, message in reader.records():
        for transition in transcript.hear(message):
            yield _row(transition, truth)
    for transition in transcript.flush():
        yield _row(transition, truth)


def _row(t: Transition, truth: Mapping[Step, Row] | None) -> Row:
    row: Row = {"session": t.session, "k": t.k, **_numbered("x_", t.x)}
    for i, u in enumerate(t.candidates or ()):
        row |= _numbered(f"u{i}_", u)
    row |= {"cipher": t.cipher, **_numbered("x_next_", t.x_next)}
    return row if truth is None else row | truth.get((t.session, t.k), {})


def _numbered(prefix: str, values: Sequence[float] | None, first: int = 1) -> Row:
    return {f"{prefix}{i}": v for i, v in enumerate(values or (), start=first)}


def write_csv(rows: Iterator[Row], out: IO[str]) -> int:
    """Write the rows under the columns of the fullest one; returns how many."""
    kept = list(rows)
    writer = csv.DictWriter(out, _columns(kept), lineterminator="\n", restval="")
    writer.writeheader()
    writer.writerows(kept)
    return len(kept)


def write_parquet(rows: Iterator[Row], path: Path) -> int:
    """Write the rows as Parquet; returns how many. Raises ImportError without pyarrow."""
    import pyarrow
    import pyarrow.parquet

    kept = list(rows)
    columns = {name: [row.get(name) for row in kept] for name in _columns(kept)}
    pyarrow.parquet.write_table(pyarrow.table(columns), path)
    return len(kept)


def _columns(rows: Sequence[Row]) -> list[str]:
    """All columns, in the order of the row that has most."""
    fullest = max(rows, key=len, default={})
    others = {name for row in rows for name in row} - set(fullest)
    return [*fullest, *sorted(others)]
