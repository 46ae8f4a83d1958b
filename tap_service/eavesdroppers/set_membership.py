"""`set-membership`: the eavesdropper of the paper, who excludes what is impossible and no more.

She knows f_c and D_e (model 10). A candidate whose Reach^e does not hold x(k+1) is excluded; the
others she takes for equally likely, although they are not. In Diff all of them remain, so a key
symbol costs her one guess in M. Whether a key was agreed she cannot tell where all remain.
"""

import random
from typing import ClassVar

from protocol.agreement import NO_SYMBOL
from protocol.knowledge import Knowledge
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers.base import (
    Belief,
    Eavesdropper,
    Follower,
    Guess,
    Model,
    even,
)


class SetMembership(Eavesdropper):
    """Excludes the candidates whose Reach^e misses x(k+1); guesses evenly among the others."""

    name: ClassVar[str] = "set-membership"

    def __init__(self, knowledge: Knowledge) -> None:
        super().__init__(knowledge)
        self._model = Model.of(knowledge, self.name)
        self._even = even(self.size)
        self._follower = Follower(self.scheme)
        # her coin for choosing among equals: seeded, so that a replay guesses as she did live
        self._coin = random.Random(0)

    def observe(self, transition: Transition) -> Guess:
        """Exclude, then guess evenly."""
        t = transition
        if t.start or t.gap:
            self._follower.restart()
        if t.x is None or t.candidates is None or t.x_next is None:
            self._follower.step(t.k, NO_SYMBOL, t.cipher)
            return Guess(t.k, self._even, 0.5)
        possible = [g <= 1.0 for g in self._model.gauges(t.x, t.candidates, t.x_next, t.centres)]
        count = sum(possible)
        if count == len(possible):
            symbol = self._coin.randrange(self.size)
            self._follower.step(t.k, symbol, t.cipher)
            return Guess(t.k, self._even, 0.5)
        self._follower.step(t.k, NO_SYMBOL, t.cipher)
        if count == 0:
            return Guess(t.k, self._even, 0.0)
        return Guess(t.k, tuple(p / count for p in possible), 0.0)

    def belief(self) -> Belief:
        """The message that her coin tosses spell."""
        return self._follower.belief(self._model)
