"""`pipelined`: the paper's scheme with one arrow moved, so that every agreement carries a symbol.

A transition that carries a message symbol is tested too, and its key is for the next one. Where
`switched` tests, carries and drops what it learnt meanwhile, this one carries under the old key and
keeps the new: at an agreement in every transition n of them carry n - 1 symbols, twice as many.

- In state 1, agreed: to state 2, which holds the key; the next ciphertext symbol is m[p] + key.
- In state 1, not agreed: it stays; the next ciphertext symbol is random.
- In state 2, agreed: it stays, and holds the new key; the receiver takes m[p] = ciphertext symbol -
  old key, and the next ciphertext symbol is m[p + 1] + new key.
- In state 2, not agreed: to state 1; the receiver takes m[p] = ciphertext symbol - key, and the
  next ciphertext symbol is random.

Carry first, then test. A key still serves one message symbol, that of the very next transition.
"""

from typing import ClassVar

from protocol.agreement import NO_SYMBOL
from protocol.schemes.base import Carry, Scheme, check_verdict
from protocol.schemes.switched import INITIAL, MESSAGE, TEST, SwitchedState, check_state


class Pipelined(Scheme[SwitchedState]):
    """Test and carry at once."""

    name: ClassVar[str] = "pipelined"
    version: ClassVar[int] = 1
    initial = INITIAL

    def advance(self, state: SwitchedState, verdict: int) -> tuple[SwitchedState, Carry]:
        """The verdict's key is held; the key held before is spent on this transition."""
        check_verdict(verdict, self.alphabet)
        check_state(state, self.alphabet)
        s = TEST if verdict == NO_SYMBOL else MESSAGE
        return SwitchedState(s, verdict), Carry(verdict, state.key)

    def pad(self, state: SwitchedState) -> int:
        """The key held, in state 2."""
        return state.key

    def tests(self, state: SwitchedState) -> bool:  # noqa: ARG002
        """In both states."""
        return True
