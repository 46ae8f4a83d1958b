"""A capture in the formats that people open: CSV, Parquet and MCAP.

CSV and Parquet have one row a message. MCAP has one channel a message type, each with the JSON
schema of the type itself.
"""

import csv
import json
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import IO, Any, Final

from protocol.messages import FieldMessage
from protocol.topics import key_of
from runtime.errors import needs
from runtime.recording import first_part, parts_of
from tap_service.capture.reading import CaptureReader

COLUMNS: Final = {
    "t_ns": "int64",
    "topic": "string",
    "session": "string",
    "k": "int64",
    "x": "vector",
    "applied_k": "int64",
    "x_after": "vector",
    "candidates": "vectors",
    "cipher": "int64",
    "copy_number": "int64",
    "nonce": "string",
    "applied_copy": "int64",
    "heard": "int64",
    "block": "int64",
    "tag": "string",
}
"""A row's columns, with their types in Parquet."""

ROWS_AT_ONCE: Final = 20_000
"""Rows of a Parquet row group."""


class ExportError(Exception):
    """The format's library is not installed; one line that says how to get it."""


def is_part(reader: CaptureReader, output: Path) -> bool:
    """Whether ``output`` is a part of the recording that is read."""
    return output.resolve() in {p.resolve() for p in parts_of(first_part(reader.path))}


def _loop(reader: CaptureReader) -> str:
    return str(reader.header.get("loop", "loop"))


def _row(t_ns: int, message: FieldMessage) -> dict[str, Any]:
    """A message's row; None where it has no such field."""
    fields = {name: getattr(message, name, None) for name in COLUMNS}
    return fields | {"t_ns": t_ns, "topic": message.topic}


def to_csv(reader: CaptureReader, out: IO[str]) -> int:
    """Write one row a message; vectors become JSON arrays in their cell. Returns the rows."""
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    rows = 0
    for t_ns, message in reader.records():
        row = _row(t_ns, message).values()
        writer.writerow(json.dumps(v) if isinstance(v, tuple) else v for v in row)
        rows += 1
    return rows


def to_parquet(reader: CaptureReader, path: Path) -> int:
    """Write one row a message, vectors as lists of doubles. Returns the rows.

    Raises
    ------
    ExportError
        When pyarrow is not installed.
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise ExportError(needs("parquet", "pyarrow")) from None
    vector = pyarrow.list_(pyarrow.float64())
    types = {
        "int64": pyarrow.int64(),
        "string": pyarrow.string(),
        "vector": vector,
        "vectors": pyarrow.list_(vector),
    }
    schema = pyarrow.schema([(name, types[of]) for name, of in COLUMNS.items()])
    rows = 0
    with pyarrow.parquet.ParquetWriter(path, schema) as writer:
        records = reader.records()
        while batch := list(islice(records, ROWS_AT_ONCE)):
            table = [_row(*record) for record in batch]
            writer.write_table(pyarrow.Table.from_pylist(table, schema=schema))
            rows += len(table)
    return rows


def to_mcap(reader: CaptureReader, path: Path) -> int:
    """Write an MCAP file, one channel a message type on its own key. Returns the messages.

    A type of which there is no message has no channel: some readers refuse one without messages.

    Raises
    ------
    ExportError
        When mcap is not installed.
    """
    try:
        from mcap.writer import Writer
    except ImportError:
        raise ExportError(needs("mcap", "mcap")) from None
    written = 0
    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start(profile="", library="wyner")
        channels: dict[str, int] = {}

        def channel_of(kind: type[FieldMessage]) -> int:
            schema = writer.register_schema(
                name=kind.__name__,
                encoding="jsonschema",
                data=json.dumps(kind.model_json_schema()).encode(),
            )
            found: int = writer.register_channel(
                topic=key_of(kind, _loop(reader)), message_encoding="json", schema_id=schema
            )
            return found

        writer.add_metadata("capture", {k: json.dumps(v) for k, v in reader.header.items()})
        for t_ns, message in reader.records():
            if message.topic not in channels:
                channels[message.topic] = channel_of(type(message))
            writer.add_message(
                channel_id=channels[message.topic],
                log_time=t_ns,
                publish_time=t_ns,
                sequence=message.k & 0xFFFFFFFF,
                data=message.wire(),
            )
            written += 1
        writer.finish()
    return written


BINARY: Final[dict[str, Callable[[CaptureReader, Path], int]]] = {
    "mcap": to_mcap,
    "parquet": to_parquet,
}
"""Formats that need a file of their own."""
