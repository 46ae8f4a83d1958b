"""`sealed`: every transition carries a message symbol under the next digit of the key stream.

The digit comes from keys that both ends distilled from what an eavesdropper misses
(:mod:`protocol.secret`). The offer names its position, and c = (m + digit) mod M. Where an offer
has no digit its symbol is random and carries nothing. What the test of a transition returns is of
no account, so nothing is agreed by the paper's rule.
"""

from typing import ClassVar, NamedTuple

from protocol.agreement import NO_SYMBOL
from protocol.schemes.base import COVER, Carry, Scheme, check_verdict


class SealedState(NamedTuple):
    """The automaton has one state."""

    s: int


class Sealed(Scheme[SealedState]):
    """Carry under the key stream; both ends substitute the digit for the pad."""

    name: ClassVar[str] = "sealed"
    version: ClassVar[int] = 1
    from_stream: ClassVar[bool] = True
    initial = SealedState(1)

    def advance(self, state: SealedState, verdict: int) -> tuple[SealedState, Carry]:
        """The same state, whatever the verdict; the automaton itself has no pad."""
        check_verdict(verdict, self.alphabet)
        if state != self.initial:
            raise ValueError(f"state: got {state.s}, expected 1")
        return state, COVER

    def pad(self, state: SealedState) -> int:  # noqa: ARG002
        """None of the automaton's own."""
        return NO_SYMBOL

    def tests(self, state: SealedState) -> bool:  # noqa: ARG002
        """Never."""
        return False
