"""Reading a capture back, part by part, also while it is being recorded."""

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from math import ceil
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError
from pydantic_core import from_json, to_json

from protocol.messages import FIELD, FieldMessage
from runtime.files import open_regular
from runtime.recording import END, LONGEST, TRACE_FORMAT, LineReader, decode, number_of, parts_of
from runtime.run_folder import CAPTURE
from tap_service.capture.recording import CAPTURE_VERSION

FIELD_TYPES: Final = {kind.topic: kind for kind in FIELD}


class CaptureError(Exception):
    """A capture that cannot be read; one line that names the file and what was expected."""


MESSAGE_BYTES: Final = 250
"""What a message's line takes, until one was given out."""

SETTINGS: Final = ("loop", "knowledge", "view")
"""What the messages of a capture mean depends on: all its parts' headers must agree on it."""


@dataclass(slots=True)
class CaptureReader:
    """Reads a capture in order, part by part, also while it is being written.

    Every line after a header is given out or counted once, as ``torn`` or ``malformed``. A
    part without a header is left out, its lines are ``torn``.

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
    malformed: int = 0
    parts_missing: int = 0
    ended: bool = False
    incarnations: int = 0
    """Recordings begun so far: where a tap was started again there are more than one."""
    header: dict[str, Any] = field(init=False)
    _number: int = field(init=False, default=0)
    _part: LineReader = field(init=False)
    _lines: deque[bytes] = field(init=False, default_factory=deque)
    _headed: bool | None = field(init=False, default=None)  # None: its first line was not read yet
    _went_on: bool = field(init=False, default=False)  # as the last part's end mark says
    _given: int = field(init=False, default=0)
    _given_bytes: int = field(init=False, default=0)

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

    @property
    def behind_steps(self) -> int:
        """About how many steps that is: two messages each, as long as those given out were."""
        mean = self._given_bytes / self._given if self._given else MESSAGE_BYTES
        return ceil(self.behind_bytes / (2 * mean))

    def records(self) -> Iterator[tuple[int, FieldMessage]]:
        """The messages that are there and were not given out yet: time (ns) and message."""
        while self._lines or self._read_on():
            line = self._lines.popleft()
            self._given += 1
            self._given_bytes += len(line) + 1
            record = self._decode(line)
            if record is not None:
                yield record

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
        self.incarnations += not self._went_on
        self._went_on = False
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
            if value is not None and value["event"] == "malformed":
                self.malformed += 1
            elif value is not None and value["event"] == END:
                self.ended = value.get("last") is True
                self._went_on = not self.ended
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
        with open_regular(path) as file:
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
