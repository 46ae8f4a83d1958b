"""Defences of a user's own, good and bad: each a class in one file."""

from typing import ClassVar

import numpy as np

from protocol.arrays import Array, Flags, Integers
from protocol.defence.base import Defence, Opened, Wire, Words


class Flip(Defence):
    """Toy: a measurement leaves with its sign turned, or not, by a bit of key."""

    name: ClassVar[str] = "flip"
    codes: ClassVar[bool] = True
    step_words = 1

    def encode(self, k: int, session: Words, step: Integers, x: Array) -> Wire:
        return Wire(x * (1.0 - 2.0 * (step[..., :1] & 1)))

    def decode(self, k: int, session: Words, step: Integers, wire: Wire) -> Opened:
        back = self.encode(k, session, step, wire.values).values
        return Opened(back, np.zeros(wire.values.shape[:-1], bool))


class Nothing(Defence):
    """Tests nothing, and guards nothing."""

    name: ClassVar[str] = "nothing"


class Greedy(Flip):
    """Takes more key than there is for one message."""

    name: ClassVar[str] = "greedy"
    step_words = 9


class Keyed(Defence):
    """A test that would take a key of its own."""

    name: ClassVar[str] = "keyed"
    step_words = 1

    def alarm(self, session: Words, step: Integers, gauges: Array) -> Flags:
        return np.zeros(gauges.shape[:-1], bool)
