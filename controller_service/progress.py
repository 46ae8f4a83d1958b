"""How far a design is, how long it still takes, and a word in time when that is too long.

Sets of three and four states grow: each takes longer than the one before, and a bar that counts
sets stands at its end for minutes. What a set takes follows from its facets, and their number grows
like a power of the set's index. So the time left is foreseen from the facets, which are exact, and
not from times alone, which a busy machine blurs. Before the first step plants of that size speak.
"""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from math import inf, log
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from controller_service.sets.design import Progress
    from protocol.convex import Polytope

PATIENCE_S: Final = 60.0
"""Seconds that a design may take unless somebody grants it more."""

QUIET_S: Final = 1.0
"""A synthesis that ends sooner shows nothing."""

JUDGED_AFTER_S: Final = 8.0
"""Seconds before which no design is called too long: the first sets say little of the last."""

MANY: Final = 1e12
"""More facets than that are never computed."""

REPEAT_S: Final = 0.1
LINES_S: Final = 10.0
"""Between two shows of progress: on a terminal, and in a pipe."""

FEW: Final = 6
"""Sets before which plants of the same size say more than the sets themselves."""

SURE_S: Final = 0.2
"""Seconds of work before which times say little."""

LAST: Final = 3
"""Sets over which times are taken."""

STEEPNESS: Final = (1.0, 1.4)
"""Least and largest power of the facets that the time of a set is believed to grow with."""

PRIOR: Final = {3: (1.0, 0.25, 4.3e-6), 4: (0.3, 0.125, 1.9e-5)}
"""By states: 1/g after the first set and its slope, where a set has (1 + g) times the facets of the
one before; and c in c f^1.15 seconds for a set of f facets. Measured of a chain and a pendulum."""
PRIOR_POWER: Final = 1.15


@dataclass(slots=True)
class Forecast:
    """Foresees the time of a design from the facets of its sets and when they were done.

    Parameters
    ----------
    begin_s : float
        Time at which the work began.
    """

    begin_s: float
    _done_s: list[float] = field(default_factory=list)
    _facets: list[int] = field(default_factory=list)
    _states: int = 0

    def made(self, now_s: float, facets: int, states: int) -> None:
        """One more set is done."""
        self._done_s.append(now_s)
        self._facets.append(facets)
        self._states = states

    def _growth(self) -> tuple[float, float]:
        """1/g of the last set, and by how much it rises with each; infinite where nothing grows."""
        f = self._facets
        first, slope, _ = PRIOR.get(self._states, (inf, 0.0, 0.0))
        if len(f) < FEW:
            return first + slope * (len(f) - 1), slope
        if f[-1] <= f[-2]:
            return inf, 0.0
        inverse = [a / (b - a) for a, b in pairwise(f[-(len(f) // 2) - 2 :]) if b > a]
        middle = (len(inverse) - 1) / 2
        mean = sum(inverse) / len(inverse)
        square = sum((i - middle) ** 2 for i in range(len(inverse)))
        rise = sum((i - middle) * v for i, v in enumerate(inverse)) / max(square, 1.0)
        rise = min(max(rise, slope / 2), 2 * slope) if slope else max(rise, 0.0)
        return max(mean + rise * middle, 0.2), rise

    def _cost(self) -> tuple[float, float]:
        """c and s, where a set of f facets takes c f^s seconds."""
        if len(self._facets) < FEW + LAST or self._done_s[-1] - self.begin_s < SURE_S:
            return PRIOR.get(self._states, (0.0, 0.0, 0.0))[2], PRIOR_POWER
        took = [max(b - a, 1e-6) for a, b in pairwise(self._done_s)]
        late, early = sum(took[-LAST:]), sum(took[-2 * LAST : -LAST])
        f_late, f_early = sum(self._facets[-LAST:]), sum(self._facets[-2 * LAST : -LAST])
        power = log(late / early) / log(f_late / f_early) if f_late > f_early else 1.0
        power = min(max(power, STEEPNESS[0]), STEEPNESS[1])
        return late / sum(f**power for f in self._facets[-LAST:]), power

    def left_s(self, sets: int) -> float:
        """Seconds for so many sets more."""
        if not self._facets:
            return 0.0
        inverse, rise = self._growth()
        cost, power = self._cost()
        facets, left = float(self._facets[-1]), 0.0
        for _ in range(min(sets, 10_000)):
            inverse += rise
            facets *= 1 + 1 / inverse
            if facets > MANY:
                return inf
            left += cost * facets**power
        return left


def in_words(seconds: float) -> str:
    """A time to wait."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h" if seconds < 3.6e5 else "days"


@contextmanager
def shown_progress(
    patience_s: float = PATIENCE_S, clock: Callable[[], float] = time.monotonic
) -> "Iterator[Progress]":
    """Progress with the time left on standard error, where the synthesis takes more than a second.

    First an estimate, before the first step; then on a terminal a line that changes, else a line
    every ten seconds.

    Parameters
    ----------
    patience_s : float
        The design is refused when it will take longer, with what to change.
    clock : callable
        Monotonic seconds.
    """
    from controller_service.sets.terminal import SynthesisError

    terminal = sys.stderr.isatty()
    begin = clock()
    outlook = Forecast(begin)
    due = begin + QUIET_S
    width = 0

    def advance(done: int, total: int, made: "Polytope") -> None:
        nonlocal due, width
        now = clock()
        states = made.H.shape[1]
        outlook.made(now, len(made.h), states)
        left = outlook.left_s(total - done)
        elapsed = now - begin
        if done == 0 and left > QUIET_S:
            text = f"{total} sets of {states} states: about {in_words(left)}"
            grow = "by plants of that size"
            if left > patience_s:
                grow = f"if they grow as without control.states; {FEW} sets will tell"
            print(f"wyner: {text}, {grow}", file=sys.stderr, flush=True)
        if done < total and elapsed > JUDGED_AFTER_S and elapsed + left > patience_s:
            needed = f"{1.5 * min(elapsed + left, 1e7):.0f}"
            raise SynthesisError(
                f"control.horizon: {total} sets would take about {in_words(elapsed + left)} "
                f"({done} are made in {in_words(elapsed)}, and they grow); control.horizon = "
                f"{max(1, done)} would do, or `wyner design FILE --patience {needed}`, once"
            )
        if now >= due:
            due = now + (REPEAT_S if terminal else LINES_S)
            line = f"sets: {done} of {total}, about {in_words(left)} left"
            if terminal:
                width = max(width, len(line))
                print(f"\r{line:<{width}}", end="", file=sys.stderr, flush=True)
            else:
                print(f"wyner: {line}", file=sys.stderr, flush=True)

    try:
        yield advance
    finally:
        if width:
            print(f"\r{'':<{width}}\r", end="", file=sys.stderr, flush=True)
