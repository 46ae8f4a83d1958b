"""`residual`: x(k+1) is one that some candidate leads to with d in D_c (equation 14). No key.

Every offer's law has it, so it is always on. Who reports what any one of the candidates could have
led to passes it for ever.
"""

from typing import ClassVar

from protocol.agreement import INSIDE
from protocol.arrays import Array, Flags, Integers
from protocol.defence.base import Defence, Words


class Residual(Defence):
    """Alarms where no candidate explains the transition."""

    name: ClassVar[str] = "residual"

    def alarm(self, session: Words, step: Integers, gauges: Array) -> Flags:  # noqa: ARG002
        """Whether every gauge is above 1, to rounding."""
        out: Flags = ~(gauges.min(-1) <= INSIDE)
        return out
