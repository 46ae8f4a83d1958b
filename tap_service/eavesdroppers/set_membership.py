"""`set-membership`: the eavesdropper of the paper, who excludes what is impossible and no more.

She knows f_c and D_e (model 10). A candidate whose Reach^e does not hold x(k+1) is excluded; the
others she takes for equally likely, although they are not. In Diff all of them remain, so a key
symbol costs her one guess in M. Whether a key was agreed she cannot tell where all remain.
"""

import random
from collections.abc import Sequence
from typing import ClassVar

from protocol.agreement import NO_SYMBOL
from protocol.knowledge import Knowledge
from protocol.vectors import Vector
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers.base import Following, Guess


class SetMembership(Following):
    """Excludes the candidates whose Reach^e misses x(k+1); guesses evenly among the others."""

    name: ClassVar[str] = "set-membership"
    corrects: ClassVar[bool] = True

    def __init__(self, knowledge: Knowledge) -> None:
        super().__init__(knowledge)
        # her coin for choosing among equals: seeded, so that a replay guesses as she did live
        self._coin = random.Random(0)

    def judged(
        self, t: Transition, x: Vector, candidates: Sequence[Vector], x_next: Vector
    ) -> tuple[int, Guess]:
        """Exclude, then guess evenly."""
        possible = [g <= 1.0 for g in self.model.gauges(x, candidates, x_next, t.predictions)]
        count = sum(possible)
        if count == len(possible):
            return self._coin.randrange(self.size), Guess(t.k, self.even, 0.5)
        if count == 0:
            return NO_SYMBOL, Guess(t.k, self.even, 0.0)
        return NO_SYMBOL, Guess(t.k, tuple(p / count for p in possible), 0.0)
