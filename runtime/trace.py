"""Traces: one JSON line an event, one recording a vantage point, readable by tests and by people.

A trace is one or more parts, ``trace.jsonl``, ``trace.0001.jsonl``, ..., each with a header that
names its number and the oldest part that was kept beside it. A file whose writer was killed may end
in a torn line; the reader drops that line only, and says so. Marks
(:mod:`runtime.jsonl`) are no events.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from runtime.jsonl import END_BYTES, MARKS, LineWriter, dumps, read_lines
from runtime.parts import Bounds, Parts, number_of, part_path, parts_of

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
#                offer's, 2 that of the measurement it answers); the plant's adds coin (b_r) and u
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
#   block        a key block was stored (either): session, number, keys
#   judged       the partner's word on it is on disk (either): session, number, what
#                ("confirmed" | "unequal")
#   appearances  how often a message of the side leaves from here on (either, where keys are made):
#                session, k (give or take one), times; a process that starts tells it first


class TraceError(Exception):
    """A trace that cannot be read; the text names the file, the line and what was expected."""


class TraceWriter:
    """Append events to a trace, each flushed to the operating system as one line.

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
        self._path = path
        heads = {"format": TRACE_FORMAT, "version": TRACE_VERSION, "vantage": vantage}
        self._told = {**heads, **header}
        self._bounds = bounds or Bounds()
        self._closed = Parts(path)
        self._number = max(self._closed.newest, 0)
        if self._closed:
            self._closed.reopen()
        self._most = self._bounds.of_a_part - END_BYTES
        self.lines = self._open()

    def write(self, event: Mapping[str, Any]) -> None:
        """Append one event."""
        line = dumps(event)
        if self.lines.size + len(line) > self._most:
            self._turn(len(line))
        self.lines.append(line)

    def _open(self, gone: Sequence[int] = ()) -> LineWriter:
        """The part in use; the parts that are ``gone`` go once its header says so."""
        oldest = self._closed.oldest(gone, self._number)
        header = {**self._told, "part": self._number, "oldest": oldest}
        lines = LineWriter(part_path(self._path, self._number), header)
        for number in gone:
            self._closed.drop(number)
        return lines

    def _turn(self, length: int) -> None:
        """End the part in use, and begin the next with room for a line of ``length`` bytes."""
        self.lines.close(next=self._number + 1)
        self._closed.add(self._number, self.lines.size)
        self._number += 1
        needed = max(self._bounds.of_a_part, len(dumps(self._told)) + length + 2 * END_BYTES)
        self.lines = self._open(self._closed.beyond(self._bounds.total_bytes - needed))

    def close(self) -> None:
        """Write the end mark and close the file; further writes fail."""
        self.lines.close()


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
