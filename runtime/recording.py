"""Recordings: JSON lines in parts of bounded size, written and read here alone.

A recording is one or more parts, ``trace.jsonl``, ``trace.0001.jsonl``, ..., each with a header
that names its number. A part that would outgrow its bound is ended and another begun; the oldest
are dropped where all together would outgrow theirs, and for no other reason.

A file is written by one process at a time, an *incarnation* of its writer. Each begins with a
header, or, where the file is there already, with the mark ``continued``. It ends with the mark
``end``, which counts its lines before it and holds their SHA-256. A process that is killed leaves
no end mark, and at most one torn line, its last: so a reader can tell a killed writer from a file
that was cut. An incarnation that goes on in the recording's next part says so in its end mark.

    {"event":"header",...}                          first incarnation
    {"event":"transition",...}
    {"event":"end","lines":2,"sha256":"9f86..."}    it ended by itself
    {"event":"continued"}                           second incarnation
    {"event":"transi                                and was killed

:class:`LineWriter` and :func:`read_lines` work on one file, :class:`Recording` on the parts of a
recording: an end's trace, which fails where the disk is full, and the tap's capture
(:mod:`tap_service.capture`), which pauses.
"""

import errno
import hashlib
import logging
import os
import re
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar, Final, NamedTuple

from pydantic import BaseModel, ConfigDict, Field
from pydantic_core import from_json, to_json

from runtime.files import make_folder, open_private, open_regular

# --- lines of one file ----------------------------------------------------------------------------

HEADER: Final = "header"
CONTINUED: Final = "continued"
END: Final = "end"
MARKS: Final = frozenset({HEADER, CONTINUED, END})

END_BYTES: Final = 256
"""Room that an end mark takes at most."""

HEADER_BYTES: Final = 1 << 16
"""A file without a whole line is a torn header only where it is smaller than this."""

HELD_BYTES: Final = 1 << 16
"""Lines of a recording that may wait for the next flush."""

READ_BYTES: Final = 1 << 20
"""Bytes that are read at once."""

LONGEST: Final = 1 << 25
"""Bytes of a line at most. A longer one is read past and counts as malformed."""


class LineWriter:
    """Append JSON lines to a file that is its owner's alone.

    Parameters
    ----------
    path : Path
        Its folder is made. An existing file is continued, on a fresh line.
    header : mapping
        The first line of a new file.
    new : bool
        The file must not be there yet; where its header cannot be written whole, it is removed.

    Attributes
    ----------
    count : int
        Lines that this writer has written whole.

    Raises
    ------
    OSError
        Here and on writing, with the file's name, when something cannot be written whole or is no
        regular file.
    """

    def __init__(self, path: Path, header: Mapping[str, Any], *, new: bool = False) -> None:
        self.path = path
        self.size = 0
        self._whole = True
        self.count = 0
        self._digest = hashlib.sha256()
        make_folder(path.parent)
        flags = os.O_RDWR | os.O_CREAT | os.O_APPEND
        self._file: int | None = open_private(path, flags | (os.O_EXCL if new else 0))
        try:
            self.size = os.fstat(self._file).st_size
            if 0 < self.size < HEADER_BYTES and b"\n" not in os.pread(self._file, self.size, 0):
                os.ftruncate(self._file, 0)  # a header that was torn: nothing is there yet
                self.size = 0
            if self.size and os.pread(self._file, 1, self.size - 1) != b"\n":
                self._put(b"\n")
            first = {"event": CONTINUED} if self.size else {"event": HEADER, **header}
            self.append(dumps(first))
        except OSError:
            self._release()
            if new:
                path.unlink(missing_ok=True)
            raise

    def append(self, *lines: bytes) -> None:
        """Hand lines (without newlines) over in one piece: from there they survive ``kill -9``.

        Where the disk is full fewer are written, :attr:`count` says how many, and it is an error.
        """
        block = b"\n".join((*lines, b""))
        written = self._put(block)
        self.count += len(lines) if written == len(block) else block.count(b"\n", 0, written)
        self._digest.update(block)
        if written < len(block):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self.path))

    def _put(self, data: bytes) -> int:
        assert self._file is not None, "the file is closed"
        try:
            written = os.write(self._file, data)
        except OSError as error:
            self._whole = False
            raise OSError(error.errno, error.strerror, str(self.path)) from None
        self.size += written
        self._whole = self._whole and written == len(data)
        return written

    def sync(self) -> None:
        """Return once all lines are on the disk."""
        assert self._file is not None, "the file is closed"
        try:
            os.fdatasync(self._file)
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(self.path)) from None

    def close(self, **told: Any) -> None:
        """Write the end mark, with ``told`` in it, and close; nothing happens the second time.

        There is no end mark where something could not be written whole.
        """
        if self._file is None:
            return
        mark = {"event": END, "lines": self.count, "sha256": self._digest.hexdigest(), **told}
        with suppress(OSError):
            if self._whole:
                self.append(dumps(mark))
        self._release()

    def _release(self) -> None:
        assert self._file is not None
        os.close(self._file)
        self._file = None


def dumps(event: Mapping[str, Any]) -> bytes:
    """An event as a line, without its newline."""
    return to_json(event, inf_nan_mode="strings")


class NumberedLine(NamedTuple):
    """A line of a file: its number from 1, its bytes without the newline, and what it holds.

    ``value`` is None where it holds no JSON object; ``raw`` is then its beginning.
    """

    number: int
    raw: bytes
    value: dict[str, Any] | None


class LineReader:
    """Whole lines of a file, in order, also while it is being written.

    Parameters
    ----------
    path : Path

    Attributes
    ----------
    offset : int
        Bytes read.
    rest : bytes
        The beginning of a line that is not finished.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.offset = 0
        self.rest = b""

    def more(self) -> list[bytes] | None:
        """The whole lines within the next `READ_BYTES` bytes; None where there is nothing to read.

        Raises
        ------
        OSError
            When the file cannot be read.
        """
        with open_regular(self.path) as file:
            file.seek(self.offset)
            chunk = file.read(READ_BYTES)
        self.offset += len(chunk)
        if not chunk:
            return None
        *lines, rest = chunk.split(b"\n")
        if lines:
            lines[0] = self.rest + lines[0]
            self.rest = rest
        elif len(self.rest) < LONGEST:
            self.rest += rest
        return lines


def decode(raw: bytes) -> dict[str, Any] | None:
    """The JSON object that a line holds; None where it holds none."""
    if len(raw) >= LONGEST:
        return None
    try:
        value = from_json(raw)
    except ValueError:
        return None
    return value if isinstance(value, dict) else None


def raw_lines(path: Path) -> Iterator[tuple[int, bytes, bool]]:
    """Every line of a file that is not empty: number, bytes, and whether it was finished.

    Raises
    ------
    OSError
        When the file cannot be read.
    """
    reader = LineReader(path)
    number = 0
    while (lines := reader.more()) is not None:
        for raw in lines:
            number += 1
            if raw:
                yield number, raw, True
    if reader.rest:
        yield number + 1, reader.rest, False


def read_lines(path: Path) -> Iterator[NumberedLine]:
    """Every line of a file that is not empty; the last may be unfinished.

    Raises
    ------
    OSError
        When the file cannot be read.
    """
    for number, raw, _finished in raw_lines(path):
        yield NumberedLine(number, raw, decode(raw))


# --- parts of a recording -------------------------------------------------------------------------

_PART: Final = re.compile(r"^(?P<stem>.+?)(?:\.(?P<part>\d{4,}))?\.jsonl$")
_MIB: Final = 2**20


class Bounds(BaseModel):
    """What a recording may take on disk.

    Parameters
    ----------
    part_bytes : int
        Size at which a part ends; it ends at half of `total_bytes` in any case, so that something
        is left when the oldest is dropped.
    total_bytes : int
        Bound of all parts together, the one in use included; the oldest are dropped to keep to it.
    free_bytes : int
        Room that must stay free on the disk; a recording that pauses on a full disk pauses below
        it, and nothing is dropped.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    part_bytes: int = Field(64 * _MIB, ge=1024)
    total_bytes: int = Field(1024 * _MIB, ge=2048)
    free_bytes: int = Field(256 * _MIB, ge=0)

    @property
    def of_a_part(self) -> int:
        """Bytes at which a part ends."""
        return min(self.part_bytes, self.total_bytes // 2)


class Recording:
    """JSON lines in parts of bounded size; the oldest parts go where all would outgrow their bound.

    A part that a line would outgrow is ended, and the next begun with room for a whole one.

    Parameters
    ----------
    path : Path
        The first part. Its folder is made.
    header : mapping
        Written first in every part, beside its number and the oldest part's.
    bounds : Bounds
    log : logging.Logger, optional
        Given: a disk that is full is no error; the recording pauses, what comes is counted as
        dropped, and the log is told. Parts that are there are kept, and a new one is begun.
        Not given: the newest part is continued.

    Attributes
    ----------
    written, dropped, parts_dropped : int
        Lines that were written and dropped, and parts.
    paused : bool
    first_part : int
        The part that it began with.
    lines : LineWriter, optional
        The writer of the part in use.

    Raises
    ------
    OSError
        Where there is no log: here and on writing, with the file's name, when something cannot be
        written whole.
    """

    LOOK_AT_DISK_S: ClassVar[float] = 1.0
    """Between two looks at the room that is left."""

    def __init__(
        self,
        path: Path,
        header: Mapping[str, Any],
        bounds: Bounds,
        log: logging.Logger | None = None,
    ) -> None:
        self.written = self.dropped = self.parts_dropped = 0
        self.paused = False
        self.lines: LineWriter | None = None
        self._path, self._header, self._bounds, self._log = path, header, bounds, log
        self._most = bounds.of_a_part - END_BYTES
        self._held: list[bytes] = []
        self._held_bytes = 0
        make_folder(path.parent)
        self._closed = {number_of(p): p.stat().st_size for p in parts_of(path)}
        self.number = max(self._closed, default=-1)
        self.first_part = max(self.number, 0) if log is None else self.number + 1
        self._begin(self.first_part)

    def put(self, *lines: bytes) -> None:
        """Append lines (without newlines) that belong together: no end of a part comes between.

        Where there is a log they are handed to the operating system by the next :meth:`flush`,
        which `HELD_BYTES` of lines bring about by themselves; else at once, in one piece.
        """
        length = sum(map(len, lines)) + len(lines)
        if self._log is not None:
            self._look(time.monotonic())
            if length + 2 * END_BYTES > self._bounds.total_bytes:
                self.dropped += len(lines)
                return
        if self.lines is not None and self.lines.size + self._held_bytes + length > self._most:
            self._turn(length)
        if self.lines is None:
            assert self._log is not None, "the recording is closed"
            self.dropped += len(lines)
            return
        self._held += lines
        self._held_bytes += length
        if self._log is None or self._held_bytes >= HELD_BYTES:
            self.flush()

    def flush(self) -> None:
        """Hand what was put to the operating system, in one piece: it survives ``kill -9``."""
        held, self._held, self._held_bytes = self._held, [], 0
        if self.lines is None or not held:
            return
        lines, before = self.lines, self.lines.count
        try:
            lines.append(*held)
        except OSError as error:
            if self._log is None:
                raise
            self.dropped += len(held) - (lines.count - before)
            self._pause(error.strerror or "write failed")
        finally:
            self.written += lines.count - before

    def sync(self) -> None:
        """Return once all that was put is on the disk: it survives a power failure."""
        self.flush()
        if self.lines is not None:
            self.lines.sync()

    def close(self) -> None:
        """End the recording: the end mark of its last part says so."""
        self.flush()
        self._end(last=True)

    def _turn(self, length: int) -> None:
        """End the part in use, and begin the next with room for a line of ``length`` bytes."""
        self.flush()
        self._end(next=self.number + 1)
        self._begin(self.number + 1, length)

    def _end(self, **told: Any) -> None:
        if self.lines is not None:
            self.lines.close(**told, **({} if self._log is None else {"dropped": self.dropped}))
            self._closed[self.number] = self.lines.size
            self.lines = None

    def _begin(self, number: int, length: int = 0) -> None:
        """Open a part with room for a line of ``length`` bytes; then the oldest go as need be."""
        header = {"part": number, **self._header}
        needed = max(self._bounds.of_a_part, len(dumps(header)) + length + 2 * END_BYTES)
        self._next_look = 0.0
        if self._log is not None and needed > self._bounds.total_bytes:
            self._pause("the bound of all parts has no room for a header")
            return
        fresh = number not in self._closed
        gone = self._beyond(self._bounds.total_bytes - needed) if fresh else []
        header["oldest"] = min((n for n in self._closed if n not in gone), default=number)
        try:
            path = part_path(self._path, number)
            self.lines = LineWriter(path, header, new=self._log is not None)
        except OSError as error:
            if self._log is None:
                raise
            self._pause(error.strerror or "cannot be opened")
            return
        self._closed.pop(number, None)
        self.number = number
        if self.paused and self._log is not None:
            self.paused = False
            self._log.info("%s: recording again, %d lines were dropped", self._path, self.dropped)
        for one in gone:
            del self._closed[one]
            part_path(self._path, one).unlink(missing_ok=True)
            self.parts_dropped += 1
        if gone and self._log is not None:
            text = "%s: part dropped, the bound of all parts is reached (%d so far)"
            self._log.warning(text, part_path(self._path, gone[-1]), self.parts_dropped)

    def _beyond(self, room: int) -> list[int]:
        """The oldest closed parts, as few of them as leave at most ``room`` bytes."""
        found, left = [], sum(self._closed.values())
        for number in sorted(self._closed):
            if left <= room:
                break
            found.append(number)
            left -= self._closed[number]
        return found

    def _pause(self, why: str) -> None:
        assert self._log is not None
        self.flush()
        self._end(last=False)
        if not self.paused:
            self.paused = True
            self._log.error("%s: recording paused: %s", self._path, why)

    def _look(self, now: float) -> None:
        """Once a second: the room that the disk has left."""
        if now < self._next_look:
            return
        if self.free_bytes() < self._bounds.free_bytes:
            self._pause(f"less than {self._bounds.free_bytes} bytes are free on the disk")
        elif self.lines is None:
            self._begin(self.number + 1)
        self._next_look = now + self.LOOK_AT_DISK_S

    def free_bytes(self) -> int:
        """Room that the disk has left."""
        status = os.statvfs(self._path.parent)
        return status.f_bavail * status.f_frsize


def part_path(path: Path, number: int) -> Path:
    """The file of part ``number`` of the recording that begins at ``path``."""
    return path if number == 0 else path.with_name(f"{path.stem}.{number:04d}.jsonl")


def number_of(path: Path) -> int:
    """The number of a part, from its name."""
    match = _PART.match(path.name)
    return int(match["part"]) if match and match["part"] else 0


def first_part(path: Path) -> Path:
    """The first part of the recording that ``path`` is a part of."""
    match = _PART.match(path.name)
    return path.with_name(f"{match['stem']}.jsonl") if match else path


def parts_of(path: Path) -> list[Path]:
    """The parts of the recording at ``path`` that are on disk, in order."""
    found = [p for p in path.parent.glob(f"{path.stem}.*.jsonl") if first_part(p) == path]
    return sorted([*found, path] if path.exists() else found, key=number_of)


def ended(path: Path) -> bool:
    """Whether the recording at ``path`` was ended by its writer, and not cut or left.

    Raises
    ------
    OSError
        When its newest part cannot be read.
    """
    newest = (parts_of(path) or [path])[-1]
    with open_regular(newest) as file:
        file.seek(max(0, file.seek(0, os.SEEK_END) - 2 * END_BYTES))
        last = file.read().rpartition(b"\n{")[2]
    return last.startswith(f'"event":"{END}"'.encode()) and last.endswith(b"}\n")


# --- traces ---------------------------------------------------------------------------------------

TRACE_FORMAT: Final = "wyner-trace"
TRACE_VERSION: Final = 2

REPORTS: Final = frozenset({"delivered", "recovered", "refused"})
"""Events that report on the transition before them, which completed a frame."""

# Events of the plant's and the controller's trace.
#   transition   one offer that the plant applied, from either side:
#                session, j, k, x, candidates, cipher, x_next, role ("test" | "message"),
#                symbol (key symbol agreed on this transition, or -1), key (the key in use on a
#                message transition, or -1), message_symbol (m[p] on a message transition, or -1),
#                p (message symbols so far, this one included), s (automaton state afterwards),
#                gauges (of x_next about each centre), counts (copies that count for keys: 1 the
#                offer's, 2 that of the measurement it answers); the plant's adds coin (b_r) and u;
#                where the key stream is used, digits (the position that the offer named) and keyed
#                (whether they served); the controller's has expected where the coin is keyed (the
#                candidate that its own digit chose, or -1)
#                a side that was killed may have written one (session, j) twice: the last counts
#   missed       a step without an offer (plant): session, k, x, u, x_next
#   interrupted  a step under way when the plant's process died or its session ended (plant):
#                session, k, x, u, x_next, candidates and coin of an offer that it had begun to
#                apply (else empty and -1)
#   timing       at the end (plant): k, steps, and (median, p99, largest) seconds of
#                sampled_late_s and actuated_after_s; overruns
#   session      a session began: session, reason
#   sent         a message was queued (controller): id, payload (base64)
#   delivered    every symbol of a frame was counted (controller): id, payload (base64)
#   recovered    a whole frame passed its check (plant): payload (base64)
#   refused      a frame failed its check (plant): session, p
#                the last three are reports on the transition before them; one that was written
#                twice has its report twice
#   alarm        a transition made an alarm (controller): session, j, k, reading (x_next), reason
#                ("unexplained" | "another candidate" | "digits refused" | "unwatched"), candidate
#                (whose prediction expected is), gauge
#   block        what became of a key block (either): session, number, what ("confirmed" |
#                "unequal" | "poor"), keys
#   appearances  how often a message of the side leaves from here on (either, where keys are made):
#                session, k (give or take one), times; a process that starts tells it first


class TraceError(Exception):
    """A trace that cannot be read; the text names the file, the line and what was expected."""


class TraceWriter(Recording):
    """The recording of an end: each event is flushed to the operating system in one piece.

    Parameters
    ----------
    path : Path
        The first part; where there are parts the newest is continued, on a fresh line.
    vantage : str
    header : mapping
    bounds : Bounds, optional

    Raises
    ------
    OSError
        Here and on writing, with the file's name, when it cannot be written whole.
    """

    def __init__(
        self, path: Path, vantage: str, header: Mapping[str, Any], bounds: Bounds | None = None
    ) -> None:
        heads = {"format": TRACE_FORMAT, "version": TRACE_VERSION, "vantage": vantage}
        super().__init__(path, {**heads, **header}, bounds or Bounds())
        self.sync()  # without its header nothing of it could be read

    def write(self, *events: Mapping[str, Any]) -> None:
        """Append a line, or several that belong together: no part and no death comes between."""
        self.put(*map(dumps, events))
