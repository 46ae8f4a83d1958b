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

:class:`LineWriter` and :func:`read_lines` work on one file, :class:`Parts` on the files of a
recording, :class:`TraceWriter` and :class:`TraceReader` on an end's trace. The tap's capture
(:mod:`tap_service.capture`) is written on the first two, since it pauses where a trace fails.
"""

import errno
import hashlib
import os
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, NamedTuple

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
    disk : callable
        Takes the file and the bytes and returns how many were written: `os.write`.

    Raises
    ------
    OSError
        Here and on writing, with the file's name, when something cannot be written whole or is no
        regular file.
    """

    def __init__(self, path: Path, header: Mapping[str, Any], *, new: bool = False) -> None:
        self.path = path
        self.size = 0
        self.disk: Callable[[int, bytes], int] = _write
        self._whole = True
        self._lines = 0
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
        """Hand lines (without newlines) over in one piece: from there they survive ``kill -9``."""
        ended = b"\n".join((*lines, b""))
        if self._put(ended) < len(ended):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self.path))
        self._lines += len(lines)
        self._digest.update(ended)

    def append_all(self, lines: Sequence[bytes]) -> int:
        """Hand several lines over in one piece; how many were written whole.

        Where it is fewer, the disk is full; the rest is lost, and so is the incarnation's end mark.
        """
        block = b"\n".join([*lines, b""])
        written = self._put(block)
        whole = len(lines) if written == len(block) else block.count(b"\n", 0, written)
        self._lines += whole
        self._digest.update(block)
        return whole

    def _put(self, data: bytes) -> int:
        assert self._file is not None, "the file is closed"
        try:
            written = self.disk(self._file, data)
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
        mark = {"event": END, "lines": self._lines, "sha256": self._digest.hexdigest(), **told}
        with suppress(OSError):
            if self._whole:
                self.append(dumps(mark))
        self._release()

    def _release(self) -> None:
        assert self._file is not None
        os.close(self._file)
        self._file = None


def _write(file: int, data: bytes) -> int:
    return os.write(file, data)


def dumps(event: Mapping[str, Any]) -> bytes:
    """An event as a line, without its newline."""
    return to_json(event, inf_nan_mode="strings")


class Line(NamedTuple):
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


def read_lines(path: Path) -> Iterator[Line]:
    """Every line of a file that is not empty; the last may be unfinished.

    Raises
    ------
    OSError
        When the file cannot be read.
    """
    for number, raw, _finished in raw_lines(path):
        yield Line(number, raw, decode(raw))


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
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    part_bytes: int = Field(64 * _MIB, ge=1024)
    total_bytes: int = Field(1024 * _MIB, ge=2048)

    @property
    def of_a_part(self) -> int:
        """Bytes at which a part ends."""
        return min(self.part_bytes, self.total_bytes // 2)


class Parts:
    """The parts of a recording: those that are closed, and the one in use.

    Parameters
    ----------
    path : Path
        The first part.

    Attributes
    ----------
    bytes : int
        All that are closed together.
    number : int
        The part in use, or the last that there was; -1 where there was none.
    lines : LineWriter, optional
        The writer of the part in use.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._sizes = {number_of(p): p.stat().st_size for p in parts_of(path)}
        self.bytes = sum(self._sizes.values())
        self.number = max(self._sizes, default=-1)
        self.lines: LineWriter | None = None

    @property
    def size(self) -> int:
        """Bytes of the part in use."""
        return 0 if self.lines is None else self.lines.size

    def begin(self, number: int, header: Mapping[str, Any], *, new: bool = False) -> None:
        """Open a part; one that is there already is continued, unless it must be ``new``.

        Raises
        ------
        OSError
            As :class:`LineWriter` does; the part in use is then the one before.
        """
        told = {"part": number, **header}
        self.lines = LineWriter(part_path(self._path, number), told, new=new)
        self.bytes -= self._sizes.pop(number, 0)
        self.number = number

    def end(self, **told: Any) -> None:
        """Close the part in use; its end mark holds what is ``told``."""
        if self.lines is not None:
            self.lines.close(**told)
            self._sizes[self.number] = self.lines.size
            self.bytes += self.lines.size
            self.lines = None

    def beyond(self, room: int) -> list[int]:
        """The oldest closed parts, as few of them as leave at most ``room`` bytes."""
        found, left = [], self.bytes
        for number in sorted(self._sizes):
            if left <= room:
                break
            found.append(number)
            left -= self._sizes[number]
        return found

    def oldest(self, gone: Collection[int], newest: int) -> int:
        """The oldest part there is beside ``newest``, once those that are ``gone`` are dropped."""
        return min((n for n in self._sizes if n not in gone), default=newest)

    def drop(self, number: int) -> Path:
        """Remove a closed part."""
        self.bytes -= self._sizes.pop(number)
        path = part_path(self._path, number)
        path.unlink(missing_ok=True)
        return path


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


class TraceWriter:
    """Append events to a trace, each flushed to the operating system in one piece.

    Parameters
    ----------
    path : Path
        The first part. Its folder is made; where there are parts the newest is continued, on a
        fresh line.
    vantage : str
    header : mapping
        Written first in every part, beside format, version, vantage point and the parts' numbers.
    bounds : Bounds, optional
        A part that would outgrow them is ended and another begun; the oldest are dropped.

    Raises
    ------
    OSError
        Here and on writing, with the file's name, when it cannot be written whole.
    """

    def __init__(
        self, path: Path, vantage: str, header: Mapping[str, Any], bounds: Bounds | None = None
    ) -> None:
        heads = {"format": TRACE_FORMAT, "version": TRACE_VERSION, "vantage": vantage}
        self._told = {**heads, **header}
        self._bounds = bounds or Bounds()
        self._parts = Parts(path)
        self._most = self._bounds.of_a_part - END_BYTES
        self._open(max(self._parts.number, 0))
        self.sync()  # without its header nothing of it could be read

    @property
    def lines(self) -> LineWriter:
        """The writer of the part in use."""
        assert self._parts.lines is not None, "the trace is closed"
        return self._parts.lines

    def write(self, *events: Mapping[str, Any]) -> None:
        """Append a line, or several that belong together: no part and no death comes between."""
        lines = [dumps(event) for event in events]
        length = sum(map(len, lines)) + len(lines) - 1
        if self.lines.size + length > self._most:
            self._turn(length)
        self.lines.append(*lines)

    def sync(self) -> None:
        """Return once all events are on the disk: they survive a power failure."""
        self.lines.sync()

    def _open(self, number: int, gone: Sequence[int] = ()) -> None:
        """Begin a part; the parts that are ``gone`` go once its header says so."""
        told = {**self._told, "oldest": self._parts.oldest(gone, number)}
        self._parts.begin(number, told)
        for one in gone:
            self._parts.drop(one)

    def _turn(self, length: int) -> None:
        """End the part in use, and begin the next with room for a line of ``length`` bytes."""
        number = self._parts.number + 1
        self.sync()
        self._parts.end(next=number)
        needed = max(self._bounds.of_a_part, len(dumps(self._told)) + length + 2 * END_BYTES)
        self._open(number, self._parts.beyond(self._bounds.total_bytes - needed))

    def close(self) -> None:
        """Write the end mark and close the file; further writes fail."""
        self._parts.end()


class TraceReader:
    """A trace, read line by line: iterate once over its events, then look at ``torn``.

    Torn lines are left out. What a killed writer wrote twice comes twice.

    Parameters
    ----------
    path : Path
        The first part, also where it is there no more.

    Attributes
    ----------
    parts_missing : int
        Parts before the first that is there.

    Raises
    ------
    TraceError
        When it cannot be read or its first whole line is no header of this format and version.
    """

    def __init__(self, path: Path) -> None:
        self.torn = 0
        parts = parts_of(path) or [path]
        self.parts_missing = number_of(parts[0])
        self._events = self._read(parts)
        self.header = next(self._events, {})
        if self.header.get("format") != TRACE_FORMAT:
            raise TraceError(f"{parts[0]}: line 1: expected a header of format {TRACE_FORMAT!r}")
        version = self.header.get("version")
        if version != TRACE_VERSION:
            said = f"version: got {version!r}, expected {TRACE_VERSION}"
            raise TraceError(f"{parts[0]}: line 1: {said}")

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return (event for event in self._events if event["event"] not in MARKS)

    def lines(self) -> Iterator[dict[str, Any]]:
        """The events, and the marks between them that tell of another process; once."""
        return self._events

    def _read(self, parts: Sequence[Path]) -> Iterator[dict[str, Any]]:
        for path in parts:
            try:
                for line in read_lines(path):
                    if line.value is not None and isinstance(line.value.get("event"), str):
                        yield line.value
                    else:
                        self.torn += 1
            except OSError as error:
                raise TraceError(f"{path}: cannot be read: {error.strerror}") from None
