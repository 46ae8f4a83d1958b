"""Stretches of a run, short enough that every step is seen: what an overview of a long one lacks.

Of a run of up to :data:`MOST_WINDOWS` stretches all are kept, of a longer one as many at equal
distances, the one about a step that was asked for, and the last. So a page of a million steps needs
no more memory than any other.
"""

from collections import deque
from dataclasses import dataclass, field
from typing import Final

from wyner.runs.check.records import MissedLine, TracedTransition

STEPS: Final = 200
"""Steps of a stretch: some three pixels each."""

MOST_WINDOWS: Final = 20
"""Stretches on a page, beside the one that was asked for and the last."""

Step = TracedTransition | MissedLine


@dataclass
class Windows:
    """Stretches of a run as its steps come.

    Parameters
    ----------
    chosen : int, optional
        A step whose stretch is kept in any case.
    """

    chosen: int | None = None
    _kept: dict[int, list[Step]] = field(default_factory=dict)
    _newest: deque[Step] = field(default_factory=lambda: deque(maxlen=STEPS))
    _every: int = 1

    def add(self, step: Step) -> None:
        """Take the next step."""
        self._newest.append(step)
        number = step.k // STEPS
        if number % self._every == 0 or number == self._asked:
            self._kept.setdefault(number, []).append(step)
            while len(self._kept) > MOST_WINDOWS + 1:
                self._every *= 2
                stays = {n for n in self._kept if n % self._every == 0} | {self._asked}
                self._kept = {n: steps for n, steps in self._kept.items() if n in stays}

    @property
    def _asked(self) -> int:
        return -1 if self.chosen is None else self.chosen // STEPS

    def step(self) -> Step | None:
        """The step that was asked for; None where it is not in the run."""
        steps = self._kept.get(self._asked, [])
        return next((step for step in steps if step.k == self.chosen), None)

    def stretches(self) -> list[list[Step]]:
        """What is kept, in order; the last one ends with the run."""
        whole = list(self._kept.values())
        if self._newest and (not whole or whole[-1][-1].k < self._newest[-1].k):
            whole.append(list(self._newest))
        return whole
