"""Captures: every field message as one JSON line, on disk before anyone looks at it.

A capture is one or more parts, ``capture.jsonl``, ``capture.0001.jsonl``, ..., each with a header
of its own. A part ends by size or age; the oldest are dropped where the whole would outgrow its
bound, and recording pauses while the disk has too little room left: both are counted and said. A
writer that is killed loses at most the line it was writing.
"""

import base64
import logging
import os
import re
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import from_json, to_json

from protocol.messages import Measurement, Offer
from protocol.trace import CAPTURE, TRACE_FORMAT, TRACE_VERSION

CAPTURE_VERSION: Final = 1
FIELD_TYPES: Final[dict[str, type[Measurement] | type[Offer]]] = {
    Measurement.topic: Measurement,
    Offer.topic: Offer,
}

_PART = re.compile(r"^(?P<stem>.+?)(?:\.(?P<part>\d{4,}))?\.jsonl$")
_MIB: Final = 2**20


class CaptureError(Exception):
    """A capture that cannot be read; one line that names the file and what was expected."""


class Limits(BaseModel):
    """Bounds of what a recording may take on disk.

    Parameters
    ----------
    part_bytes, part_s : int, float
        Size and age at which a part ends.
    total_bytes : int
        Bound of all parts together; the oldest are dropped beyond it.
    free_bytes : int
        Room that must stay free on the disk; recording pauses below it.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    part_bytes: int = Field(64 * _MIB, ge=1024)
    part_s: float = Field(3600.0, gt=0)
    total_bytes: int = Field(1024 * _MIB, ge=2048)
    free_bytes: int = Field(256 * _MIB, ge=0)


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

    _LOOK_AT_DISK_S: Final = 1.0

    def __init__(
        self, path: Path, header: Mapping[str, Any], limits: Limits, log: logging.Logger
    ) -> None:
        self.written = 0
        self.dropped = 0
        self.parts_dropped = 0
        self.paused = False
        self._current = path
        self._size = 0
        self._held: list[bytes] = []
        self._held_bytes = 0
        self._path = path
        self._header = header
        self._limits = limits
        self._log = log
        path.parent.mkdir(parents=True, exist_ok=True)
        self._parts = {p: p.stat().st_size for p in parts_of(path)}
        self._number = max((number_of(p) for p in self._parts), default=-1)
        self._old_bytes = sum(self._parts.values())
        self._file: int | None = None
        self._begin()

    @property
    def size(self) -> int:
        """Bytes on disk, all parts together."""
        return self._old_bytes + self._size

    def write(self, line: bytes) -> None:
        """Append one line (without its newline), or count it as dropped while paused.

        It is handed to the operating system by the next :meth:`flush`, which `HELD_BYTES` of lines
        bring about by themselves.
        """
        now = time.monotonic()
        if now >= self._next_look:
            self._look(now)
        if self._file is None:
            self.dropped += 1
            return
        self._held.append(line)
        self._held_bytes += len(line) + 1
        if self._size + self._held_bytes >= self._limits.part_bytes:
            self._begin()
        elif self._held_bytes >= HELD_BYTES:
            self.flush()

    def flush(self) -> None:
        """Hand what was written to the operating system, in one piece: it survives ``kill -9``."""
        held, self._held, self._held_bytes = self._held, [], 0
        if self._file is None or not held:
            return
        block = b"\n".join([*held, b""])
        try:
            written = os.write(self._file, block)
        except OSError as error:
            self._pause(error.strerror or "write failed")
            self.dropped += len(held)
            return
        self._size += written
        whole = len(held) if written == len(block) else block.count(b"\n", 0, written)
        self.written += whole
        if whole != len(held):
            self.dropped += len(held) - whole
            self._pause("disk full")

    def close(self) -> None:
        """End the recording."""
        self.flush()
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _begin(self) -> None:
        self.flush()
        if self._file is not None:
            os.close(self._file)
            self._parts[self._current] = self._size
            self._old_bytes += self._size
        self._file = None
        self._size = 0
        self._number += 1
        self._current = part_path(self._path, self._number)
        self._began = time.monotonic()
        self._next_look = 0.0
        self._make_room(self._limits.total_bytes - self._limits.part_bytes)
        header = {
            "event": "header",
            "format": TRACE_FORMAT,
            "version": TRACE_VERSION,
            "vantage": "tap",
            "capture_version": CAPTURE_VERSION,
            "part": self._number,
            "started_ns": time.time_ns(),
            **self._header,
        }
        try:
            file = os.open(self._current, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
            line = to_json(header, inf_nan_mode="strings") + b"\n"
            self._size = os.write(file, line)
        except OSError as error:
            self._pause(error.strerror or "cannot be opened")
            return
        self._file = file
        if self.paused:
            self.paused = False
            self._log.info("%s: recording again, %d lines were dropped", self._path, self.dropped)

    def _make_room(self, allowed: int) -> None:
        while self._parts and self._old_bytes > max(allowed, 0):
            self._drop_oldest("the bound of all parts is reached")

    def _drop_oldest(self, why: str) -> None:
        oldest = min(self._parts, key=number_of)
        self._old_bytes -= self._parts.pop(oldest)
        oldest.unlink(missing_ok=True)
        self.parts_dropped += 1
        self._log.warning("%s: part dropped, %s (%d so far)", oldest, why, self.parts_dropped)

    def _pause(self, why: str) -> None:
        self.close()
        if not self.paused:
            self.paused = True
            self._log.error("%s: recording paused: %s", self._path, why)

    def _look(self, now: float) -> None:
        """Once a second: the part's age, and the room that the disk has left."""
        self._next_look = now + self._LOOK_AT_DISK_S
        while self._free() < self._limits.free_bytes and self._parts:
            self._drop_oldest("the disk has too little room left")
        if self._free() < self._limits.free_bytes:
            self._pause(f"less than {self._limits.free_bytes} bytes are free on the disk")
        elif self._file is None or now - self._began >= self._limits.part_s:
            self._begin()
            self._next_look = now + self._LOOK_AT_DISK_S

    def _free(self) -> int:
        status = os.statvfs(self._path.parent)
        return status.f_bavail * status.f_frsize


def part_path(path: Path, number: int) -> Path:
    """The file of part ``number`` of the recording that begins at ``path``."""
    return path if number == 0 else path.with_name(f"{path.stem}.{number:04d}.jsonl")


def number_of(path: Path) -> int:
    """The number of a part, from its name."""
    match = _PART.match(path.name)
    return int(match["part"]) if match and match["part"] else 0


def parts_of(path: Path) -> list[Path]:
    """The parts of the recording at ``path`` that are on disk, in order."""
    found = [p for p in path.parent.glob(f"{path.stem}.*jsonl") if _PART.match(p.name)]
    mine = [p for p in found if p == path or _PART.match(p.name)["stem"] == path.stem]  # type: ignore[index]
    return sorted(mine, key=number_of)


def mirror_line(t_ns: int, topic: str, payload: bytes) -> bytes:
    """The capture line of a message that was decoded; ``payload`` is its JSON."""
    if b"\n" in payload or b"\r" in payload:
        payload = to_json(from_json(payload))
    return b'{"event":"field","t_ns":%d,"topic":"%s","message":%s}' % (
        t_ns,
        topic.encode(),
        payload,
    )


def garbage_line(t_ns: int, key: str, payload: bytes) -> bytes:
    """The capture line of something on a field key that is no message."""
    return to_json(
        {
            "event": "garbage",
            "t_ns": t_ns,
            "key": key,
            "base64": base64.b64encode(payload).decode("ascii"),
        }
    )


@dataclass(slots=True)
class CaptureReader:
    """Reads a capture in order, part by part, also while it is being written.

    Parameters
    ----------
    path : Path
        The capture's first part, or the directory of a run.

    Raises
    ------
    CaptureError
        When there is no such capture, or a part's first line is no header of a known version.
    """

    path: Path
    torn: int = 0
    garbage: int = 0
    parts_missing: int = 0
    skipped: int = 0
    header: dict[str, Any] = field(init=False)
    _number: int = field(init=False, default=0)
    _offset: int = field(init=False, default=0)
    _rest: bytes = field(init=False, default=b"")

    _CHUNK: Final = 1 << 20

    def __post_init__(self) -> None:
        if self.path.is_dir():
            self.path /= CAPTURE
        parts = parts_of(self.path)
        if not parts:
            raise CaptureError(f"{self.path}: cannot be read: no such capture")
        self._number = number_of(parts[0])
        self.parts_missing = self._number
        self.header = _read_header(parts[0])

    @property
    def behind_bytes(self) -> int:
        """Bytes on disk that were not read yet."""
        sizes = {p: p.stat().st_size for p in parts_of(self.path) if number_of(p) >= self._number}
        return sum(sizes.values()) - self._offset

    def records(self) -> Iterator[tuple[int, Measurement | Offer]]:
        """The messages that are there and were not given out yet: time (ns) and message."""
        while True:
            path = part_path(self.path, self._number)
            later = [n for n in map(number_of, parts_of(self.path)) if n > self._number]
            chunk = self._more(path)
            if chunk is None and later:
                self.parts_missing += 1
            elif chunk:
                yield from self._decode(chunk)
                continue
            if not later:
                return
            self.torn += bool(self._rest)
            self.parts_missing += later[0] - self._number - 1
            self._number, self._offset, self._rest = later[0], 0, b""

    def skip_to_last_part(self) -> None:
        """Leave everything before the newest part unread, and count its lines as skipped."""
        last = number_of(parts_of(self.path)[-1])
        while self._number < last:
            while chunk := self._more(part_path(self.path, self._number)):
                self.skipped += chunk.count(b"\n")
            self._number, self._offset, self._rest = self._number + 1, 0, b""

    def _more(self, path: Path) -> bytes | None:
        try:
            with path.open("rb") as file:
                file.seek(self._offset)
                chunk = file.read(self._CHUNK)
        except FileNotFoundError:
            return None
        self._offset += len(chunk)
        return chunk

    def _decode(self, chunk: bytes) -> Iterator[tuple[int, Measurement | Offer]]:
        *lines, self._rest = (self._rest + chunk).split(b"\n")
        for line in lines:
            try:
                value = from_json(line)
                event = value["event"]
                if event == "field":
                    message = FIELD_TYPES[value["topic"]].model_validate_json(
                        to_json(value["message"])
                    )
                    yield value["t_ns"], message
                else:
                    self.garbage += event == "garbage"
            except (ValueError, KeyError, TypeError, ValidationError):
                self.torn += 1

    def finish(self) -> None:
        """Count a last line that was never finished; after the last record of an ended capture."""
        self.torn += bool(self._rest)
        self._rest = b""


def _read_header(path: Path) -> dict[str, Any]:
    try:
        with path.open("rb") as file:
            line = file.readline()
    except OSError as error:
        raise CaptureError(f"{path}: cannot be read: {error.strerror}") from None
    try:
        header = from_json(line)
    except ValueError:
        header = None
    if not isinstance(header, dict) or header.get("format") != TRACE_FORMAT:
        raise CaptureError(f"{path}: line 1: expected a header of format {TRACE_FORMAT!r}")
    if header.get("vantage") != "tap" or header.get("capture_version") != CAPTURE_VERSION:
        raise CaptureError(
            f"{path}: line 1: capture_version: got {header.get('capture_version')!r}, "
            f"expected {CAPTURE_VERSION}"
        )
    return header
