"""Key blocks as one end's transitions make them."""

from collections.abc import Iterator
from itertools import count
from typing import NamedTuple

import numpy as np

from protocol.link.distiller import BlockEnded
from protocol.secret.blocks import Schedule
from wyner.runs.trace import Indices, Places, Trace


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
    rows: Indices
    steps: int
    counts: Indices

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
        self._schedule, self._trace = schedule, trace
        self._places = Places(trace, trace.rows, by="j")

    def of(self, session: str, number: int) -> TracedBlock | None:
        """One of them; None where it is not whole, or does not follow a transition."""
        first, length = self._schedule.begins(number), self._schedule.length(number)
        j = np.arange(first - 1, first + length)
        at = self._places.all_of(self._places.session(session), j)
        if (at < 0).any():
            return None
        rows, k = at[1:], self._trace.rows["k"]
        assumption = self._schedule.assumption
        counts = [assumption.counting(n) for n in self._trace.rows["counts"][rows].tolist()]
        return TracedBlock(session, number, rows, int(k[rows[-1]] - k[at[0]]), np.array(counts))

    def __iter__(self) -> Iterator[TracedBlock]:
        for session in self._trace.sessions:
            for number in count():
                block = self.of(session, number)
                if block is None:
                    break
                yield block


def ended(trace: Trace) -> Iterator[BlockEnded]:
    """The blocks of which an end has keys, or had too few copies for any."""
    for told in trace.told("block"):
        if isinstance(told.line, BlockEnded) and told.line.what != "unequal":
            yield told.line
