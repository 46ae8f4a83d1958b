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

from protocol.messages import FieldMessage, Measurement
from protocol.topics import key_of
from runtime.errors import needs
from runtime.recording import first_part, parts_of
from tap_service.capture.reading import CaptureReader

KEY_FIELDS: Final = ("copy_number", "nonce", "applied_copy", "heard", "block", "tag")

ROWS_AT_ONCE: Final = 20_000
"""Rows of a Parquet row group."""


class ExportError(Exception):
    """The format's library is not installed; one line that says how to get it."""


def is_part(reader: CaptureReader, output: Path) -> bool:
    """Whether ``output`` is a part of the recording that is read."""
    return output.resolve() in {p.resolve() for p in parts_of(first_part(reader.path))}


def _loop(reader: CaptureReader) -> str:
    return str(reader.header.get("loop", "loop"))


def to_csv(reader: CaptureReader, out: IO[str]) -> int:
    """Write one row a message; vectors become JSON arrays in their cell. Returns the rows."""
    writer = csv.writer(out, lineterminator="\n")
    names = ("t_ns", "topic", "session", "k", "x", "applied_k", "x_after", "candidates", "cipher")
    writer.writerow((*names, *KEY_FIELDS))
    rows = 0
    for t_ns, message in reader.records():
        row: list[object] = [t_ns, message.topic, message.session, message.k]
        if isinstance(message, Measurement):
            row += [json.dumps(message.x), message.applied_k, json.dumps(message.x_after), "", ""]
        else:
            row += ["", "", "", json.dumps(message.candidates), message.cipher]
        writer.writerow(row + [getattr(message, name, "") for name in KEY_FIELDS])
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
    schema = pyarrow.schema(
        [
            ("t_ns", pyarrow.int64()),
            ("topic", pyarrow.string()),
            ("session", pyarrow.string()),
            ("k", pyarrow.int64()),
            ("x", vector),
            ("applied_k", pyarrow.int64()),
            ("x_after", vector),
            ("candidates", pyarrow.list_(vector)),
            ("cipher", pyarrow.int64()),
            ("copy_number", pyarrow.int64()),
            ("nonce", pyarrow.string()),
            ("applied_copy", pyarrow.int64()),
            ("heard", pyarrow.int64()),
            ("block", pyarrow.int64()),
            ("tag", pyarrow.string()),
        ]
    )
    rows = 0
    with pyarrow.parquet.ParquetWriter(path, schema) as writer:
        records = reader.records()
        while batch := list(islice(records, ROWS_AT_ONCE)):
            columns = [_columns(schema.names[2:], *record) for record in batch]
            writer.write_table(pyarrow.Table.from_pylist(columns, schema=schema))
            rows += len(columns)
    return rows


def _columns(names: list[str], t_ns: int, message: FieldMessage) -> dict[str, object]:
    columns = {name: getattr(message, name, None) for name in names}
    return {"t_ns": t_ns, "topic": message.topic, **columns}


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
