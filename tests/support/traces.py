"""A trace that is over, whole in memory."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from runtime.recording import TraceReader
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
