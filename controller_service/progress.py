"""How far a design is, how long it still takes, and a word in time when that is too long.

Sets of three and four states grow: each takes longer than the one before, and a bar that counts
sets stands at its end for minutes. The time left is foreseen from how the last times grew.
"""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from math import log
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from controller_service.sets.design import Progress

PATIENCE_S: Final = 60.0
"""Seconds that a design may take unless somebody grants it more."""

QUIET_S: Final = 1.0
"""A synthesis that ends sooner shows nothing."""

JUDGED_AFTER_S: Final = 8.0
"""Seconds before which no design is called too long: the first sets say little of the last."""

REPEAT_S: Final = 0.1
LINES_S: Final = 10.0
"""Between two shows of progress: on a terminal, and in a pipe."""

LAST: Final = 4
"""Sets over which growth is taken."""

STEEPEST: Final = 3.0
"""Power of the set's index that is believed at most."""


@dataclass(slots=True)
class Outlook:
    """Foresees the time of a design from the times at which its sets were done.

    Parameters
    ----------
    begin_s : float
        Time at which the work began.
    """

    begin_s: float
    _done_s: list[float] = field(default_factory=list)

    def made(self, now_s: float) -> None:
        """One more set is done."""
        self._done_s.append(now_s)

    def _last_and_power(self) -> tuple[float, float]:
        """Mean time of the last sets, and p where the time of set i grows as i to the power p."""
        times = [self.begin_s, *self._done_s]
        took = [max(b - a, 1e-6) for a, b in pairwise(times)]
        span = min(LAST, len(took) // 2)
        if span == 0:
            return took[-1], 0.0
        late, early = sum(took[-span:]), sum(took[-2 * span : -span])
        middle = len(took) - (span - 1) / 2
        power = log(late / early) / log(middle / (middle - span))
        return late / span, min(max(power, 0.0), STEEPEST)

    def left_s(self, sets: int) -> float:
        """Seconds for so many sets more."""
        if not self._done_s:
            return 0.0
        last, power = self._last_and_power()
        made = len(self._done_s)
        more = range(1, min(sets, 10_000) + 1)
        return float(sum(last * ((made + j) / made) ** power for j in more))


def in_words(seconds: float) -> str:
    """A time to wait."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{min(seconds / 3600, 999):.1f} h"


@contextmanager
def shown_progress(
    patience_s: float = PATIENCE_S, clock: Callable[[], float] = time.monotonic
) -> "Iterator[Progress]":
    """Progress with the time left on standard error, once the synthesis has taken a second.

    On a terminal a line that changes, else a line every ten seconds.

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
    outlook = Outlook(begin)
    due = begin + QUIET_S
    width = 0

    def advance(done: int, total: int) -> None:
        nonlocal due, width
        now = clock()
        outlook.made(now)
        left = outlook.left_s(total - done)
        elapsed = now - begin
        if elapsed > JUDGED_AFTER_S and elapsed + left > patience_s:
            needed = int(1.5 * (elapsed + left)) + 1
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
