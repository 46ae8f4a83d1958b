"""The test where a plant is read through some outputs alone, y = C x + n: what both ends evaluate.

Both hold the same box of the state (:mod:`protocol.box_observer`). It moves on with a transition,
from the box before, the offer and the reading after it; over missed steps it is predicted with the
fallback's input, and meets the reading with which the next offer is asked for.
"""

from dataclasses import dataclass
from typing import Final

from protocol.agreement import NO_SYMBOL, AgreementResult, Gauge, predict, spread
from protocol.box_observer import Box, BoxObserver, Estimate
from protocol.link.fallback import Fallback
from protocol.vectors import Vector

MOST_MISSED: Final = 64
"""Missed steps in a row over which the box is predicted; after more it begins anew."""

OUTSIDE: Final = 1.0 + 1e-6
"""Least gauge of a candidate that is ruled out: clear of :data:`protocol.agreement.INSIDE`."""


@dataclass(frozen=True, slots=True)
class OutputRule:
    """The agreement test on readings y = C x + n, and the state that the controller reckons with.

    A symbol is agreed where exactly one candidate explains the reading, and every B (u_i - u_j) is
    in (alpha - 1) D_c: then Eve finds all of them possible, whatever Eve remembers.

    Parameters
    ----------
    observer : BoxObserver
    apart : Gauge
        Of D_c.
    alpha : float
    fallback : Fallback
    """

    observer: BoxObserver
    apart: Gauge
    alpha: float
    fallback: Fallback

    def box(self, estimate: Estimate | None, missed: int, y: Vector) -> Box:
        """Where the state lies that is read as ``y``, ``missed`` steps after the estimate."""
        if estimate is None or missed > MOST_MISSED:
            return self.observer.begin(y)
        return self.observer.met(self._predicted(estimate, missed), y) if missed else estimate.box

    def instead(self, estimate: Estimate | None, missed: int, in_force: Vector) -> Vector:
        """The input of a missed step, ``missed`` of which came before it since the estimate.

        The fallback sees the state that both ends predict, and no reading: the controller heard of
        none meanwhile.
        """
        if estimate is None or missed >= MOST_MISSED:
            return self.fallback.input((0.0,) * len(self.observer.A), in_force)
        return self.fallback.input(self._predicted(estimate, missed).centre, in_force)

    def _predicted(self, estimate: Estimate, missed: int) -> Box:
        """The box after some missed steps, of which nothing was read."""
        box, inputs = estimate
        for _ in range(missed):
            if self.fallback.kind != "hold":
                inputs = (self.fallback.input(box.centre, inputs[0]),)
            box = self.observer.moved(box, inputs)
        return box

    def predictions(self, box: Box, candidates: tuple[Vector, ...]) -> list[Vector]:
        """The state expected after each candidate, shape (n,): A and B on the box's centre."""
        observer, centre = self.observer, box.centre
        return [predict(observer.A, observer.B, centre, u) for u in candidates]

    def judge(self, box: Box, candidates: tuple[Vector, ...], y_next: Vector) -> AgreementResult:
        """The verdict of a transition from a state in ``box`` to one that is read as ``y_next``.

        A candidate's gauge is how far y_next lies from the reading expected, over how far it may;
        up to 1 for those that explain it, and above for the others.
        """
        observer = self.observer
        found = observer.step(box, candidates, y_next)
        predictions, reach = self.predictions(box, candidates), observer.reach(box)
        gauges = []
        for i, centre in enumerate(predictions):
            away = zip(y_next, observer.read(centre), reach, strict=True)
            gauge = max(abs(y - c) / r for y, c, r in away)
            gauges.append(min(gauge, 1.0) if i in found.possible else max(gauge, OUTSIDE))
        inside = len(found.possible)
        together = 1.0 + spread(self.apart, predictions) <= self.alpha
        symbol = found.possible[0] if inside == 1 and together else NO_SYMBOL
        inputs = tuple([candidates[i] for i in found.possible]) or candidates
        return AgreementResult(
            tuple(gauges), symbol, inside, box=box, estimate=Estimate(found.box, inputs)
        )
