"""A trace that is over, whole in memory; and what was recovered, while it is written."""

import base64
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from runtime.recording import (
    CONTINUED,
    MARKS,
    REPORTS,
    TRACE_FORMAT,
    TRACE_VERSION,
    TraceError,
    number_of,
    parts_of,
    read_lines,
)
from runtime.run_folder import PLANT_TRACE
from wyner.runs.resolve import Counts, Resolver

Event = dict[str, Any]


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


@dataclass(frozen=True, slots=True)
class Trace:
    """What a trace holds: its header, and its events, each once."""

    header: dict[str, Any]
    events: tuple[dict[str, Any], ...]
    torn: int
    parts_missing: int

    def of(self, event: str) -> Iterator[dict[str, Any]]:
        """The events of one kind, in order."""
        return (e for e in self.events if e["event"] == event)


def read_trace(path: Path) -> Trace:
    """Read a whole trace."""
    reader = TraceReader(path)
    events = tuple(Resolved(reader.lines()))
    return Trace(reader.header, events, reader.torn, reader.parts_missing)


class Recovered:
    """The messages that the plant of a run has recovered so far, in order.

    The trace is read through only where it tells of another number of them than last time: a test
    that waits asks a hundred times a second.
    """

    def __init__(self, run_dir: Path) -> None:
        self._path = run_dir / PLANT_TRACE
        self._found: list[bytes] = []

    def __call__(self) -> list[bytes]:
        """What there is now."""
        try:
            lines = self._path.read_bytes().count(b'"event":"recovered"')
        except OSError:
            return []
        if lines != len(self._found):
            events = read_trace(self._path).of("recovered")
            self._found = [base64.b64decode(event["payload"]) for event in events]
        return list(self._found)


class Resolved:
    """The events of a trace that count, each once: iterate once.

    Of a step that was traced twice the last counts. A missed step that was traced and never saved
    does not count where it was made again. Marks of the writer's incarnations are left out.

    Parameters
    ----------
    lines : iterable of dict
        The events of a trace, marks included.

    Attributes
    ----------
    behind : int
        Steps that an end made again after its journal was put back: time went on, and nothing was
        counted.
    """

    def __init__(self, lines: Iterable[Event]) -> None:
        self.behind = 0
        self._lines = lines
        self._resolver = Resolver()
        self._held: list[Event] = []  # a step that may be made again, and what followed it

    def __iter__(self) -> Iterator[Event]:
        for event in self._lines:
            kind = event["event"]
            if kind in MARKS:
                if kind == CONTINUED:
                    self._resolver.restart()
            elif kind == "transition":
                yield from self._transition(event)
            elif kind in ("missed", "interrupted"):
                yield from self._missed(event)
            elif kind not in REPORTS or self._resolver.report() is Counts.NEW:
                if kind == "session":
                    self._resolver.session(event.get("session"))
                yield from self._next(event)
        yield from self._held

    def _transition(self, event: Event) -> Iterator[Event]:
        restarted = self._resolver.restarted
        session, k = str(event["session"]), event["k"]
        counts = self._resolver.transition(session, event["j"], k)
        if counts is Counts.NEW:
            yield from self._step(event, restarted)
        elif counts is Counts.BEHIND:
            self.behind += 1
        elif self._held and self._held[0]["event"] == "transition":
            self._held[0] = event
        else:
            self._held = self._held[1:]  # missed after it, and never saved

    def _missed(self, event: Event) -> Iterator[Event]:
        restarted = self._resolver.restarted
        if self._resolver.missed(str(event["session"]), event["k"]) is Counts.BEHIND:
            self.behind += 1
        else:
            yield from self._step(event, restarted)

    def _step(self, event: Event, restarted: bool) -> Iterator[Event]:
        held = self._held
        if restarted and held and held[0]["event"] != "transition" and _same(held[0], event):
            held = held[1:]
        self._held = [event]
        yield from held

    def _next(self, event: Event) -> Iterator[Event]:
        if self._held:
            self._held.append(event)
        else:
            yield event


def _same(a: Event, b: Event) -> bool:
    return (a.get("session"), a.get("k")) == (b.get("session"), b.get("k"))
