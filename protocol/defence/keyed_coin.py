"""`keyed-coin`: the plant applies the candidate that the key says, and the controller knows which.

x(k+1) must be what that one candidate leads to with d in D_c. Packed predictions are more than two
half-lengths of D_c apart, so no reading fits two of them.
"""

import math
from typing import ClassVar

import numpy as np

from protocol.agreement import INSIDE
from protocol.arrays import Array, Flags, Integers
from protocol.defence.base import Defence, Words


class KeyedCoin(Defence):
    """Alarms where the keyed candidate does not explain the transition; a base-M digit a step."""

    name: ClassVar[str] = "keyed-coin"

    @property
    def key_bits(self) -> float:
        """log2(M)."""
        return math.log2(self.candidates)

    def step_key(self, draw: np.random.Generator, runs: tuple[int, ...]) -> Integers:
        """A uniform digit, shape (..., 1)."""
        return draw.integers(self.candidates, size=(*runs, 1))

    def coin(self, session: Words, step: Integers) -> Integers:  # noqa: ARG002
        """The digit."""
        return step[..., 0]

    def alarm(self, session: Words, step: Integers, gauges: Array) -> Flags:  # noqa: ARG002
        """Whether the keyed candidate's gauge is above 1, to rounding."""
        out: Flags = ~(np.take_along_axis(gauges, step, -1)[..., 0] <= INSIDE)
        return out
