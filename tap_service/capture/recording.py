"""Recording a capture: every field message as one JSON line, on disk before anyone looks at it.

A capture is one or more parts, ``capture.jsonl``, ``capture.0001.jsonl``, ..., each with a header
of its own. A part ends by size or age; the oldest are dropped where the whole would outgrow its
bound, and for no other reason. Recording pauses while the disk has too little room left. Both are
counted and said. A writer that is killed loses at most the line it was writing.
"""

import base64
import logging
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from pydantic import Field
from pydantic_core import from_json, to_json

from runtime.recording import (
    END_BYTES,
    TRACE_FORMAT,
    TRACE_VERSION,
    Bounds,
    Parts,
    dumps,
)

CAPTURE_VERSION: Final = 2


class Limits(Bounds):
    """Bounds of what the tap may take on disk: those of its parts, and two more.

    Parameters
    ----------
    part_s : float
        Age at which a part ends.
    free_bytes : int
        Room that must stay free on the disk; recording pauses below it, and nothing is dropped.
    """

    part_s: float = Field(3600.0, gt=0)
    free_bytes: int = Field(256 * 2**20, ge=0)


HELD_BYTES: Final = 1 << 16
"""Lines of a recording that may wait for the next flush."""


class RotatingLog:
    """JSON lines in parts of bounded size, each line handed to the operating system whole.

    Parameters
    ----------
    path : Path
        The first part; later ones carry a number before the suffix. Parts that are already there
        are kept, and a new one is begun.
    header : mapping
        Written first in every part, beside its format, version, number and start.
    limits : Limits
    log : logging.Logger
        Told when a part is dropped, and when recording pauses and resumes.
    """

    LOOK_AT_DISK_S: Final = 1.0
    """Between two looks at the room that is left."""

    def __init__(
        self, path: Path, header: Mapping[str, Any], limits: Limits, log: logging.Logger
    ) -> None:
        self.written = 0
        self.dropped = 0
        self.parts_dropped = 0
        self.paused = False
        self._held: list[bytes] = []
        self._held_bytes = 0
        self._path = path
        self._header = header
        self._limits = limits
        self._of_a_part = limits.of_a_part
        self._log = log
        path.parent.mkdir(parents=True, exist_ok=True)
        self._parts = Parts(path)
        self.first_part = self._parts.number + 1
        self._begin()

    def write(self, line: bytes) -> None:
        """Append one line (without its newline), or count it as dropped.

        It is dropped while paused, and where it and the part in use exceed the bound of all parts.
        It is handed to the operating system by the next :meth:`flush`, which `HELD_BYTES` of lines
        bring about by themselves.
        """
        now = time.monotonic()
        if now >= self._next_look:
            self._look(now)
        if self._parts.lines is None or not self._make_room(len(line) + 1):
            self.dropped += 1
            return
        self._held.append(line)
        self._held_bytes += len(line) + 1
        if self._parts.size + self._held_bytes >= self._of_a_part:
            self._begin()
        elif self._held_bytes >= HELD_BYTES:
            self.flush()

    def flush(self) -> None:
        """Hand what was written to the operating system, in one piece: it survives ``kill -9``."""
        held, self._held, self._held_bytes = self._held, [], 0
        lines = self._parts.lines
        if lines is None or not held:
            return
        try:
            whole = lines.append_all(held)
        except OSError as error:
            self.dropped += len(held)
            self._pause(error.strerror or "write failed")
            return
        self.written += whole
        if whole != len(held):
            self.dropped += len(held) - whole
            self._pause("disk full")

    def close(self) -> None:
        """End the recording: its last part says so."""
        self._end(last=True)

    def _end(self, *, last: bool = False) -> None:
        self.flush()
        self._parts.end(dropped=self.dropped, last=last)

    def _begin(self) -> None:
        self._end()
        self._began = time.monotonic()
        self._next_look = 0.0
        number = self._parts.number + 1
        header = {
            "format": TRACE_FORMAT,
            "version": TRACE_VERSION,
            "vantage": "tap",
            "capture_version": CAPTURE_VERSION,
            "started_ns": time.time_ns(),
            **self._header,
        }
        if not self._make_room(len(dumps(header)) + 1):
            self._pause("the bound of all parts has no room for a header")
            return
        try:
            self._parts.begin(number, header, new=True)
        except OSError as error:
            self._pause(error.strerror or "cannot be opened")
            return
        if self.paused:
            self.paused = False
            self._log.info("%s: recording again, %d lines were dropped", self._path, self.dropped)

    def _make_room(self, length: int) -> bool:
        """Drop the oldest parts until ``length`` bytes more fit; False where they never do."""
        needed = self._parts.size + self._held_bytes + length + END_BYTES
        if needed > self._limits.total_bytes:
            return False
        for number in self._parts.beyond(self._limits.total_bytes - needed):
            oldest = self._parts.drop(number)
            self.parts_dropped += 1
            self._log.warning(
                "%s: part dropped, the bound of all parts is reached (%d so far)",
                oldest,
                self.parts_dropped,
            )
        return True

    def _pause(self, why: str) -> None:
        self._end()
        if not self.paused:
            self.paused = True
            self._log.error("%s: recording paused: %s", self._path, why)

    def _look(self, now: float) -> None:
        """Once a second: the part's age, and the room that the disk has left."""
        self._next_look = now + self.LOOK_AT_DISK_S
        if self.free_bytes() < self._limits.free_bytes:
            self._pause(f"less than {self._limits.free_bytes} bytes are free on the disk")
        elif self._parts.lines is None or now - self._began >= self._limits.part_s:
            self._begin()
            self._next_look = now + self.LOOK_AT_DISK_S

    def free_bytes(self) -> int:
        """Room that the disk has left."""
        status = os.statvfs(self._path.parent)
        return status.f_bavail * status.f_frsize


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
