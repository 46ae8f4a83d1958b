"""How punctual the plant's steps are, and whether D_c keeps what was promised of it."""

from bisect import bisect_left, insort
from collections import deque
from typing import Final

from protocol.agreement import INSIDE, AgreementResult
from protocol.link.events import Timing
from protocol.scenario import Calibration
from protocol.statistics import better_than
from protocol.vectors import Vector

STEPS: Final = 1000
"""Newest steps that the figures describe."""

DOUBT: Final = 0.001
"""Largest probability, over all sessions, that a kept promise is doubted."""


class Punctuality:
    """Lateness of the last :data:`STEPS` steps; of a plant in lock-step there is none."""

    def __init__(self) -> None:
        self._sampled = _Newest()
        self._actuated = _Newest()
        self.overruns = 0

    def ticked(self, late_s: float, overruns: int) -> None:
        """A step was found to be over ``late_s`` after its end."""
        self._sampled.add(late_s)
        self.overruns = overruns

    def acted(self, after_s: float) -> None:
        """An input was applied ``after_s`` after its step began."""
        self._actuated.add(after_s)

    @property
    def sampled_late_s(self) -> Vector:
        """Median, 99th percentile and largest; empty before the first step."""
        return self._sampled.spread()

    @property
    def actuated_after_s(self) -> Vector:
        """Median, 99th percentile and largest; empty before the first step."""
        return self._actuated.spread()

    def as_event(self, k: int) -> Timing | None:
        """For the trace; None where nothing was measured."""
        steps = len(self._sampled)
        if not steps:
            return None
        return Timing(k, steps, self.sampled_late_s, self.actuated_after_s, self.overruns)


class _Newest:
    """The newest :data:`STEPS` values in order of age and of size, so that no status sorts them."""

    def __init__(self) -> None:
        self._by_age: deque[float] = deque()
        self._ordered: list[float] = []

    def __len__(self) -> int:
        return len(self._ordered)

    def add(self, value: float) -> None:
        """Take in a value; the oldest goes where there is no room."""
        if len(self._by_age) == STEPS:
            del self._ordered[bisect_left(self._ordered, self._by_age.popleft())]
        self._by_age.append(value)
        insort(self._ordered, value)

    def spread(self) -> Vector:
        """Median, 99th percentile and largest; empty of none."""
        ordered, last = self._ordered, len(self._ordered) - 1
        return (ordered[last // 2], ordered[-(-99 * last // 100)], ordered[last]) if ordered else ()


class ReachWatch:
    """Counts transitions whose disturbance left D_c, and tests the calibration's promise with them.

    Parameters
    ----------
    calibration : Calibration, optional
    """

    def __init__(self, calibration: Calibration | None) -> None:
        self._calibration = calibration
        self._in_session = 0
        self._left = False
        self._contradicted = False
        self.sessions = self.exceeded = 0
        self.outside = 0

    def counted(self, verdict: AgreementResult, coin: int) -> str | None:
        """Count a transition; a line the first time that the promise is contradicted.

        ``outside`` is exact, as the plant knows its coin.
        """
        out = verdict.gauges[coin] > INSIDE
        self.outside += out
        c = self._calibration
        if c is None:
            return None
        self._in_session += 1
        self._left = self._left or out
        if self._in_session < c.steps:
            return None
        self.sessions += 1
        self.exceeded += self._left
        self._in_session, self._left = 0, False
        return self._doubted(c)

    def _doubted(self, c: Calibration) -> str | None:
        if self._contradicted:
            return None
        if not better_than(c.violation, self.exceeded, self.sessions, DOUBT):
            return None
        self._contradicted = True
        return (
            f"D_c does not hold what was promised: {self.exceeded} of {self.sessions} times "
            f"{c.steps} steps left it, expected at most {c.violation:.3g} of them; fit it anew"
        )

    @property
    def doubt(self) -> str:
        """What the status says of it, or nothing."""
        return "D_c is left more often than its calibration promised" if self._contradicted else ""
