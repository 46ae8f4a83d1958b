"""Key blocks as one end's transitions make them."""

from collections.abc import Iterator
from itertools import count
from typing import Any, NamedTuple

import numpy as np

from protocol.secret.blocks import Schedule
from wyner.runs.lines import TRANSITION, BlockLine
from wyner.runs.trace import Trace


class TracedBlock(NamedTuple):
    """A block all of whose transitions were traced.

    Parameters
    ----------
    session, number
    rows : integer array
        Where its transitions stand in the trace.
    steps : int
        Missed ones included.
    counts : integer array
        Of each transition, the copies that count: 1 the offer's, 2 the measurement's.
    """

    session: str
    number: int
    rows: np.ndarray[Any, np.dtype[np.int64]]
    steps: int
    counts: np.ndarray[Any, np.dtype[np.int64]]

    @property
    def counted(self) -> int:
        """Copies that count."""
        return int((self.counts & 1).sum() + (self.counts >> 1).sum())

    def secret_rows(self, schedule: Schedule) -> int:
        """R, of which one is shown and the others are keys."""
        return schedule.assumption.rows(len(self.rows), self.steps, self.counted)


class Blocks:
    """The whole blocks of a trace, by session and number."""

    def __init__(self, schedule: Schedule, trace: Trace) -> None:
        self._schedule, self._rows = schedule, trace.rows
        self._sessions: dict[str, Any] = {}
        number = trace.rows["session"]
        for i, name in enumerate(trace.sessions):
            first, last = np.searchsorted(number, [i, i + 1])
            here = first + np.flatnonzero(trace.rows["kind"][first:last] == TRANSITION)
            self._sessions[name] = here.astype(np.int32)

    def of(self, session: str, number: int) -> TracedBlock | None:
        """One of them; None where it is not whole, or does not follow a transition."""
        here = self._sessions.get(session)
        if here is None:
            return None
        first, length = self._schedule.begins(number), self._schedule.length(number)
        at, after = np.searchsorted(self._rows["j"][here], [first, first + length])
        if at == 0 or after - at != length:
            return None
        rows, k = here[at:after], self._rows["k"]
        counts = np.array(
            [self._schedule.assumption.counting(n) for n in self._rows["counts"][rows].tolist()]
        )
        return TracedBlock(session, number, rows, int(k[rows[-1]] - k[here[at - 1]]), counts)

    def __iter__(self) -> Iterator[TracedBlock]:
        for session in self._sessions:
            for number in count():
                block = self.of(session, number)
                if block is None:
                    break
                yield block


def ended(trace: Trace) -> Iterator[BlockLine]:
    """The blocks of which an end has keys, or had too few copies for any."""
    for told in trace.told("block"):
        if isinstance(told.line, BlockLine) and told.line.what != "unequal":
            yield told.line
