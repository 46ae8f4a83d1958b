"""A trace that is over, whole in memory; and what was recovered, while it is written."""

import base64
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from runtime.recording import TraceReader
from runtime.run_folder import PLANT_TRACE
from wyner.runs.resolve import Resolved


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
