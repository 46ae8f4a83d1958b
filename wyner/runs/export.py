"""A capture as MCAP, CSV or Parquet: a row or record a message, or a row a step."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from runtime.errors import UsageError
from runtime.files import PUBLIC_FILE, replacing
from tap_service.capture.export import BINARY, is_part, to_csv
from tap_service.capture.reading import CaptureReader
from wyner.runs.run import Run
from wyner.runs.score.step_table import step_rows, truth_of, write_csv, write_parquet

KINDS: Final = (".csv", ".parquet", ".mcap")
"""What a file's name ends in."""


def export_messages(capture: Path, output: Path) -> str:
    """Write a row or record for each message that the tap heard; returns how many, in words.

    Parameters
    ----------
    capture : Path
        A capture, or a run's folder.
    output : Path
        The ending of its name says which format.

    Raises
    ------
    UsageError, CaptureError
        When the output is the capture itself, or there is no capture that can be read.
    ExportError
        When the format's library is not installed.
    OSError
        When the file cannot be written.
    """
    reader = CaptureReader(capture)
    if is_part(reader, output):
        raise UsageError(f"--output: {output}: is a part of the capture itself")
    with replacing(output, PUBLIC_FILE) as path:
        if output.suffix == ".csv":
            with path.open("w", encoding="utf-8", newline="") as file:
                count = to_csv(reader, file)
        else:
            count = BINARY[output.suffix[1:]](reader, path)
    reader.finish()
    return f"{count} messages, {reader.malformed} undecodable left out, {reader.torn} torn lines"


def export_steps(capture: Path, output: Path) -> str:
    """Write a row for each step, one column a number; of a run with what the plant knows beside it.

    Raises
    ------
    CaptureError, RunError
        When there is no capture, or no plant's trace, that can be read.
    ImportError
        When pyarrow is not installed.
    OSError
        When the file cannot be written.
    """
    is_run = capture.is_dir() and (run := Run.load(capture)).has("plant")
    known = truth_of(run) if is_run else None

    def rows() -> Iterator[dict[str, Any]]:
        return step_rows(CaptureReader(capture), known)

    with replacing(output, PUBLIC_FILE) as path:
        if output.suffix == ".parquet":
            count = write_parquet(rows, path)
        else:
            with path.open("w", encoding="utf-8", newline="") as file:
                count = write_csv(rows, file)
    return f"{count} steps"
