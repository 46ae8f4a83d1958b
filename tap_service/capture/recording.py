"""Captures: every field message as one JSON line, on disk before anyone looks at it.

A capture is one or more parts, ``capture.jsonl``, ``capture.0001.jsonl``, ..., each with a header
of its own. A part ends by size or age; the oldest are dropped where the whole would outgrow its
bound, and for no other reason. Recording pauses while the disk has too little room left. Both are
counted and said. A writer that is killed loses at most the line it was writing.
"""

import base64
import logging
import os
import time
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from pydantic import Field, ValidationError
from pydantic_core import from_json, to_json

from protocol.messages import FIELD, FieldMessage
from protocol.runtime.jsonl import END, END_BYTES, LONGEST, LineReader, LineWriter, decode, dumps
from protocol.runtime.parts import Bounds, Parts, number_of, part_path, parts_of
from protocol.runtime.run_folder import CAPTURE
from protocol.runtime.trace import TRACE_FORMAT, TRACE_VERSION

CAPTURE_VERSION: Final = 1
FIELD_TYPES: Final = {kind.topic: kind for kind in FIELD}


class CaptureError(Exception):
    """A capture that cannot be read; one line that names the file and what was expected."""


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

    _LOOK_AT_DISK_S: Final = 1.0

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
        self._log = log
        path.parent.mkdir(parents=True, exist_ok=True)
        self._parts = Parts(path)
        self._number = self._parts.newest
        self.first_part = self._number + 1
        self._file: LineWriter | None = None
        self._begin()

    @property
    def size(self) -> int:
        """Bytes on disk, all parts together."""
        return self._parts.bytes + self._size

    @property
    def _size(self) -> int:
        return 0 if self._file is None else self._file.size

    def write(self, line: bytes) -> None:
        """Append one line (without its newline), or count it as dropped.

        It is dropped while paused, and where it and the part in use exceed the bound of all parts.
        It is handed to the operating system by the next :meth:`flush`, which `HELD_BYTES` of lines
        bring about by themselves.
        """
        now = time.monotonic()
        if now >= self._next_look:
            self._look(now)
        if self._file is None or not self._make_room(len(line) + 1):
            self.dropped += 1
            return
        self._held.append(line)
        self._held_bytes += len(line) + 1
        if self._size + self._held_bytes >= self._limits.of_a_part:
            self._begin()
        elif self._held_bytes >= HELD_BYTES:
            self.flush()

    def flush(self) -> None:
        """Hand what was written to the operating system, in one piece: it survives ``kill -9``."""
        held, self._held, self._held_bytes = self._held, [], 0
        if self._file is None or not held:
            return
        try:
            whole = self._file.append_all(held)
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
        if self._file is None:
            return
        self._file.close(dropped=self.dropped, last=last)
        self._parts.add(self._number, self._file.size)
        self._file = None

    def _begin(self) -> None:
        self._end()
        self._began = time.monotonic()
        self._next_look = 0.0
        number = self._number + 1
        path = part_path(self._path, number)
        header = {
            "format": TRACE_FORMAT,
            "version": TRACE_VERSION,
            "vantage": "tap",
            "capture_version": CAPTURE_VERSION,
            "part": number,
            "started_ns": time.time_ns(),
            **self._header,
        }
        if not self._make_room(len(dumps(header)) + 1):
            self._pause("the bound of all parts has no room for a header")
            return
        try:
            self._file = LineWriter(path, header, new=True)
        except OSError as error:
            self._pause(error.strerror or "cannot be opened")
            return
        self._number = number
        if self.paused:
            self.paused = False
            self._log.info("%s: recording again, %d lines were dropped", self._path, self.dropped)

    def _make_room(self, length: int) -> bool:
        """Drop the oldest parts until ``length`` bytes more fit; False where they never do."""
        needed = self._size + self._held_bytes + length + END_BYTES
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
        self._next_look = now + self._LOOK_AT_DISK_S
        if self._free() < self._limits.free_bytes:
            self._pause(f"less than {self._limits.free_bytes} bytes are free on the disk")
        elif self._file is None or now - self._began >= self._limits.part_s:
            self._begin()
            self._next_look = now + self._LOOK_AT_DISK_S

    def _free(self) -> int:
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


END_BEGINS: Final = b'{"event":"end",'

SETTINGS: Final = ("loop", "knowledge", "view")
"""What the messages of a capture mean depends on: all its parts' headers must agree on it."""


@dataclass(slots=True)
class CaptureReader:
    """Reads a capture in order, part by part, also while it is being written.

    Every line after a header is given out or counted once: as ``torn``, ``garbage`` or ``skipped``.
    A part without a header is left out, its lines are ``torn``.

    Parameters
    ----------
    path : Path
        The capture's first part, or the directory of a run.
    like : mapping, optional
        A header: the parts up to the last one that was recorded with other settings are left out.

    Raises
    ------
    CaptureError
        When there is no such capture, or no part has a header, or one's is of another version or
        of other settings than the first's; also while reading, for a part that came later.
    """

    path: Path
    like: Mapping[str, Any] | None = None
    torn: int = 0
    garbage: int = 0
    parts_missing: int = 0
    skipped: int = 0
    ended: bool = False
    header: dict[str, Any] = field(init=False)
    _number: int = field(init=False, default=0)
    _part: LineReader = field(init=False)
    _lines: deque[bytes] = field(init=False, default_factory=deque)
    _headed: bool | None = field(init=False, default=None)  # None: its first line was not read yet

    def __post_init__(self) -> None:
        if self.path.is_dir():
            self.path /= CAPTURE
        parts = parts_of(self.path)
        if parts and parts[0] != self.path:
            self.parts_missing = number_of(parts[0])
        headers = {p: _header_of(_first_line(p)) for p in parts}
        if self.like is not None:
            mine = from_json(to_json(self.like, inf_nan_mode="strings"))
            others = [p for p, h in headers.items() if h is not None and _differs(h, mine)]
            parts = parts[parts.index(others[-1]) + 1 :] if others else parts
            if others and not parts:
                raise CaptureError(f"{self.path}: no part with these settings")
        if not parts:
            raise CaptureError(f"{self.path}: cannot be read: no such capture")
        headed = [(p, h) for p in parts if (h := headers[p]) is not None]
        if not headed:
            raise CaptureError(f"{parts[0]}: line 1: expected a header of format {TRACE_FORMAT!r}")
        self._enter(parts[0])
        self.header = headed[0][1]
        for path, header in headed:
            self._check(path, header)

    @property
    def behind_bytes(self) -> int:
        """Bytes of lines that were not given out yet."""
        behind = sum(len(line) + 1 for line in self._lines)
        for path in parts_of(self.path):
            if number_of(path) >= self._number:
                read = self._part.offset if number_of(path) == self._number else 0
                behind += max(_size_of(path) - read, 0)
        return behind

    def records(self) -> Iterator[tuple[int, FieldMessage]]:
        """The messages that are there and were not given out yet: time (ns) and message."""
        while self._lines or self._read_on():
            record = self._decode(self._lines.popleft())
            if record is not None:
                yield record

    def skip(self, keep: int) -> None:
        """Leave lines unread, and count them, until at most ``keep`` bytes are left.

        Whole chunks are skipped, so that up to `CHUNK` less may be left.
        """
        while self.behind_bytes > keep and (self._lines or self._read_on()):
            self.skipped += sum(not line.startswith(END_BEGINS) for line in self._lines)
            self._lines.clear()

    def finish(self) -> None:
        """Count a last line that was never finished; after the last record of an ended capture."""
        self.torn += bool(self._part.rest)
        self._part.rest = b""

    def _read_on(self) -> bool:
        """Read until there are lines to give out; False when there are none yet."""
        while not self._lines:
            gone, lines = False, None
            try:
                lines = self._part.more()
            except FileNotFoundError:
                gone = True
            if lines is not None:
                self._sort(lines)
                continue
            later = [p for p in parts_of(self.path) if number_of(p) > self._number]
            if not later:
                return False
            self.torn += bool(self._part.rest) or (not gone and self._part.offset == 0)
            self.parts_missing += gone + number_of(later[0]) - self._number - 1
            self._enter(later[0])
        return True

    def _enter(self, part: Path) -> None:
        self._number, self._part, self._headed = number_of(part), LineReader(part), None

    def _sort(self, lines: list[bytes]) -> None:
        """Check a part's first line; without a header the others are left out."""
        if lines and self._headed is None:
            header = _header_of(lines[0])
            if header is not None:
                self._check(self._part.path, header)
                del lines[0]
            self._headed = header is not None
        if self._headed:
            self._lines.extend(lines)
        else:
            self.torn += len(lines)

    def _decode(self, line: bytes) -> tuple[int, FieldMessage] | None:
        value = decode(line)
        try:
            if value is not None and value["event"] == "garbage":
                self.garbage += 1
            elif value is not None and value["event"] == END:
                self.ended = value.get("last") is True
            elif value is not None:
                message = FIELD_TYPES[value["topic"]].model_validate_json(to_json(value["message"]))
                return value["t_ns"], message
            else:
                self.torn += 1
        except (ValueError, KeyError, TypeError, ValidationError):
            self.torn += 1
        return None

    def _check(self, path: Path, header: Mapping[str, Any]) -> None:
        if difference := _differs(header, self.header):
            raise CaptureError(f"{path}: line 1: {difference}")


def _size_of(path: Path) -> int:
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return 0


def _first_line(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.readline(LONGEST)
    except FileNotFoundError:
        return b""
    except OSError as error:
        raise CaptureError(f"{path}: cannot be read: {error.strerror}") from None


def _header_of(line: bytes) -> dict[str, Any] | None:
    """The header that a part's first line holds; None where it is none."""
    header = decode(line)
    return header if header is not None and header.get("format") == TRACE_FORMAT else None


def _differs(header: Mapping[str, Any], first: Mapping[str, Any]) -> str:
    """Why a part with this header cannot be read after one with the other; empty where it can."""
    if header.get("vantage") != "tap" or header.get("capture_version") != CAPTURE_VERSION:
        return f"capture_version: got {header.get('capture_version')!r}, expected {CAPTURE_VERSION}"
    for name in SETTINGS:
        if header.get(name) != first.get(name):
            return (
                f"{name}: differs from the first part's, as the tap was started again with other "
                f"options; move the parts from here on to a folder of their own"
            )
    return ""
