"""`nearest-centre`: takes the likeliest candidate, and one threshold for "a key was agreed".

In an agreed step the true candidate has a gauge (in D_c) of at most 1 and every other of more, and
scaling the set keeps that order: the candidate nearest to x(k+1) is the key symbol, always, at
every alpha. Only *when* a key was agreed is hidden, behind a threshold. Her estimate of it is the
largest nearest gauge so far, times a margin: the disturbance fills its set, so that the estimate
grows towards the set's edge from inside. Under a law of which it is public that every transition
agrees, *when* is no question, and she needs no threshold. Where the plant's sensors are noisy she
measures along the one row of D_e that tells the candidates apart. Where outputs alone are read she
measures readings, and takes none of a session's first steps for agreed: no estimate has settled.
"""

from collections.abc import Sequence
from typing import ClassVar

from protocol.agreement import NO_SYMBOL
from protocol.knowledge import Knowledge
from protocol.vectors import Vector
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers.base import Following, Guess

MARGIN = 1.1
"""Threshold over the largest nearest gauge seen: a defender's set is drawn with room to spare."""


class NearestCentre(Following):
    """Takes the candidate whose centre is nearest to x(k+1) in the shape of D_e."""

    name: ClassVar[str] = "nearest-centre"

    def __init__(self, knowledge: Knowledge) -> None:
        super().__init__(knowledge)
        self._largest = 0.0
        self.noisy = knowledge.noisy

    def judged(
        self, t: Transition, x: Vector, candidates: Sequence[Vector], x_next: Vector
    ) -> tuple[int, Guess]:
        """Measure every candidate; the nearest is the guess."""
        settled = self.model.settled
        measure = self.model.along_the_widest if self.noisy else self.model.gauges
        gauges = measure(x, candidates, x_next, t.predictions)
        nearest = min(gauges)
        ties = gauges.count(nearest)
        self._largest = max(self._largest, nearest)
        threshold = MARGIN * self._largest
        inside = sum(g <= threshold for g in gauges)
        agreed = settled and (self.certain or (inside == 1 and max(gauges) <= 1.0))
        symbol = gauges.index(nearest)
        follows = symbol if agreed else NO_SYMBOL
        if ties > 1:
            share = 1.0 / ties
            return follows, Guess(t.k, tuple(share if g == nearest else 0.0 for g in gauges), 0.0)
        certain = tuple(1.0 if i == symbol else 0.0 for i in range(len(gauges)))
        return follows, Guess(t.k, certain, 1.0 if agreed else 0.0)
