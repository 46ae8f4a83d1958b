"""JSON lines: the one writer and the one reader of every recording.

A file is written by one process at a time, in *lives*. A life begins with a header, or, where the
file is there already, with the mark ``continued``. It ends with the mark ``end``, which counts the
life's lines before it and holds their SHA-256. A process that is killed leaves no end mark, and at
most one torn line, its last: so a reader can tell a killed writer from a file that was cut. A life
that goes on in the recording's next part says so in its end mark.

    {"event":"header",...}                          first life
    {"event":"transition",...}
    {"event":"end","lines":2,"sha256":"9f86..."}    it ended by itself
    {"event":"continued"}                           second life
    {"event":"transi                                and was killed
"""

import errno
import hashlib
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, NamedTuple

from pydantic_core import from_json, to_json

from runtime.files import make_folder, open_private

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

    def append(self, line: bytes) -> None:
        """Hand one line (without its newline) to the operating system: it survives ``kill -9``."""
        ended = line + b"\n"
        if self._put(ended) < len(ended):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self.path))
        self._lines += 1
        self._digest.update(ended)

    def append_all(self, lines: Sequence[bytes]) -> int:
        """Hand several lines over in one piece; how many were written whole.

        Where it is fewer, the disk is full; the rest is lost, and so is the life's end mark.
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
        with self.path.open("rb") as file:
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
