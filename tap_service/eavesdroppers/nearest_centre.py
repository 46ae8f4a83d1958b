"""`nearest-centre`: takes the likeliest candidate, and one threshold for "a key was agreed".

In an agreed step the true candidate has a gauge (in D_c) of at most 1 and every other of more, and
scaling the set keeps that order: the candidate nearest to x(k+1) is the key symbol, always, at
every alpha. Only *when* a key was agreed is hidden, behind a threshold. Her estimate of it is the
largest nearest gauge so far, times a margin: the disturbance fills its set, so that the estimate
grows towards the set's edge from inside. Under a law of which it is public that every transition
agrees, *when* is no question, and she needs no threshold. Where the plant's sensors are noisy she
measures along the one row of D_e that tells the candidates apart; where d is Gaussian, in the
deviations that she was told. Where outputs alone are read she
measures readings; where all agree but a session's first steps, she follows the scheme under every
number of those, and takes the one whose frame has its check. What the ends may have lost after a
stretch of missed steps she takes for agreed.
"""

from collections.abc import Sequence
from operator import sub
from typing import TYPE_CHECKING, ClassVar

from protocol.agreement import NO_SYMBOL, deviation, predict
from protocol.knowledge import Knowledge
from protocol.vectors import Vector
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers.base import (
    Belief,
    Follower,
    Following,
    Guess,
    MessageSymbols,
    nearest,
    opening_of,
)

if TYPE_CHECKING:
    from tap_service.inference.opening import Opening

MARGIN = 1.1
"""Threshold over the largest nearest gauge seen: a defender's set is drawn with room to spare."""


class NearestCentre(Following):
    """Takes the candidate whose centre is nearest to x(k+1) in the shape of D_e."""

    name: ClassVar[str] = "nearest-centre"
    corrects: ClassVar[bool] = True

    def __init__(self, knowledge: Knowledge) -> None:
        super().__init__(knowledge)
        self._largest = 0.0
        self.noisy = knowledge.noisy
        self._opening = opening_of(self.model, self.size, certain=self.certain)
        lost = () if self._opening is None else self._opening.lost
        self._followers = {number: Follower(self.scheme) for number in lost}

    def observe(self, transition: Transition) -> Guess:
        """Follow the scheme; what was not heard whole is guessed evenly."""
        if self._opening is None:
            return super().observe(transition)
        return self._observe_outputs(self._opening, transition)

    def _observe_outputs(self, opening: "Opening", transition: Transition) -> Guess:
        known, gauges = opening.take(transition)
        for one in known:
            t, symbol = one.transition, one.symbol
            for lost, follower in self._followers.items():
                if t.start or t.gap:
                    follower.restart()
                early = not one.again and 0 <= one.place < lost
                follower.step(t.k, NO_SYMBOL if symbol is None or early else symbol, t.cipher)
        if gauges is None:
            return Guess(transition.k, self.even, 0.5)
        return Guess(transition.k, nearest(gauges), float(self.model.settled))

    def belief(self) -> Belief:
        """The message that her verdicts spell; where outputs are read, of who has read most."""
        return self._best().belief(self.model)

    def message_symbols(self) -> MessageSymbols:
        """What her verdicts make of the ciphertext."""
        return self._best().message_symbols()

    def _best(self) -> Follower:
        if self._opening is None:
            return self.follower
        return max(self._followers.values(), key=lambda follower: follower.whole_count)

    def judged(
        self, t: Transition, x: Vector, candidates: Sequence[Vector], x_next: Vector
    ) -> tuple[int, Guess]:
        """Measure every candidate; the nearest is the guess."""
        settled = self.model.settled
        measure = self.model.along_the_widest if self.noisy else self.model.gauges
        gauges = measure(x, candidates, x_next, t.predictions)
        if (deviations := self.knowledge.deviations) is not None:
            centres = t.predictions or [
                predict(self.model.A, self.model.B, x, u) for u in candidates
            ]
            off = [tuple(map(sub, x_next, centre)) for centre in centres]
            gauges = [deviation(v, deviations) for v in off]
        least = min(gauges)
        self._largest = max(self._largest, least)
        threshold = MARGIN * self._largest
        inside = sum(g <= threshold for g in gauges)
        agreed = settled and (self.certain or (inside == 1 and max(gauges) <= 1.0))
        sure = agreed and gauges.count(least) == 1
        symbol = gauges.index(least) if agreed else NO_SYMBOL
        return symbol, Guess(t.k, nearest(gauges), float(sure))
