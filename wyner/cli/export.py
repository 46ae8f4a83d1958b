"""A capture as MCAP, CSV or Parquet, for ``wyner report --to``."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from runtime.errors import DONE, Failure, UsageError, needs, writing
from runtime.files import PUBLIC_FILE, replacing
from tap_service.capture.export import BINARY, ExportError, is_part, to_csv
from tap_service.capture.reading import CaptureError, CaptureReader
from wyner.runs.run import Run, RunError
from wyner.runs.score.step_table import step_rows, truth_of, write_csv, write_parquet


def export(capture: Path, kind: str, output: Path | None, *, steps: bool) -> int:
    """Write a capture and say on standard error how much it holds; return the exit code.

    Parameters
    ----------
    capture : Path
        A capture, or a run's folder.
    kind : str
        "csv", "parquet" or "mcap".
    output : Path, optional
        CSV goes to standard output where no file is named.
    steps : bool
        One row a step, of a run with what the plant knows beside it.

    Raises
    ------
    UsageError
        When there is no such capture, or the options do not fit one another.
    Failure
        When the file cannot be written.
    """
    if steps and kind == "mcap":
        raise UsageError("--steps: expected --to csv or --to parquet")
    if output is None and kind != "csv":
        output = Path(f"{'steps' if steps else 'capture'}.{kind}")
    try:
        with writing(f"--output: {output or kind}"):
            said = _written(capture, kind, output, steps=steps)
    except (CaptureError, RunError) as error:
        raise UsageError(str(error)) from None
    except ExportError as error:
        raise Failure(str(error)) from None
    except ImportError:
        raise Failure(needs("parquet", "pyarrow")) from None
    print(said, file=sys.stderr)
    return DONE


def _written(capture: Path, kind: str, output: Path | None, *, steps: bool) -> str:
    """Write the steps or the messages; return what is said of it."""
    if steps:
        return f"{_write_steps(capture, kind, output)} steps"
    return _write_messages(capture, kind, output)


def _write_messages(capture: Path, kind: str, output: Path | None) -> str:
    """Write one row or record a message; return what is said of it."""
    reader = CaptureReader(capture)
    if output is None:
        count = to_csv(reader, sys.stdout)
    elif is_part(reader, output):
        raise UsageError(f"--output: {output}: is a part of the capture itself")
    else:
        with replacing(output, PUBLIC_FILE) as path:
            if kind == "csv":
                with path.open("w", encoding="utf-8", newline="") as file:
                    count = to_csv(reader, file)
            else:
                count = BINARY[kind](reader, path)
    reader.finish()
    return f"{count} messages, {reader.malformed} undecodable left out, {reader.torn} torn lines"


def _write_steps(capture: Path, kind: str, output: Path | None) -> int:
    """Write one row a step; return how many."""
    is_run = capture.is_dir() and (run := Run.load(str(capture))).has("plant")
    known = truth_of(run) if is_run else None

    def rows() -> Iterator[dict[str, Any]]:
        return step_rows(CaptureReader(capture), known)

    if output is None:
        return write_csv(rows, sys.stdout)
    with replacing(output, PUBLIC_FILE) as path:
        if kind == "parquet":
            return write_parquet(rows, path)
        with path.open("w", encoding="utf-8", newline="") as file:
            return write_csv(rows, file)
