"""Recording a capture: every field message as one JSON line, on disk before anyone looks at it.

A capture is one or more parts, ``capture.jsonl``, ``capture.0001.jsonl``, ..., each with a header
of its own. A part ends by size; the oldest are dropped where the whole would outgrow its
bound, and for no other reason. Recording pauses while the disk has too little room left. Both are
counted and said. A writer that is killed loses at most the line it was writing.
"""

import base64
import logging
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from pydantic_core import from_json, to_json

from runtime.recording import TRACE_FORMAT, TRACE_VERSION, Bounds, Recording

CAPTURE_VERSION: Final = 2


class RotatingLog(Recording):
    """The recording of a tap.

    Parameters
    ----------
    path : Path
        The first part; parts that are already there are kept, and a new one is begun.
    header : mapping
        Written first in every part, beside its format, version, number and start.
    limits : Bounds
    log : logging.Logger
        Told when a part is dropped, and when recording pauses and resumes.
    """

    def __init__(
        self, path: Path, header: Mapping[str, Any], limits: Bounds, log: logging.Logger
    ) -> None:
        heads = {
            "format": TRACE_FORMAT,
            "version": TRACE_VERSION,
            "vantage": "tap",
            "capture_version": CAPTURE_VERSION,
            "started_ns": time.time_ns(),
        }
        super().__init__(path, {**heads, **header}, limits, log)

    def write(self, line: bytes) -> None:
        """Append one line (without its newline), or count it as dropped."""
        self.put(line)


def mirror_line(t_ns: int, topic: str, payload: bytes) -> bytes:
    """The capture line of a message that was decoded; ``payload`` is its JSON."""
    if b"\n" in payload or b"\r" in payload:
        payload = to_json(from_json(payload))
    return b'{"event":"field","t_ns":%d,"topic":"%s","message":%s}' % (
        t_ns,
        topic.encode(),
        payload,
    )


def malformed_line(t_ns: int, key: str, payload: bytes) -> bytes:
    """The capture line of something on a field key that is no message."""
    return to_json(
        {
            "event": "malformed",
            "t_ns": t_ns,
            "key": key,
            "base64": base64.b64encode(payload).decode("ascii"),
        }
    )
