"""`pipelined`: the paper's scheme with one arrow moved, so that every agreement carries a symbol.

A transition that carries a message symbol is tested too, and its key is for the next one. Where
`switched` tests, carries and drops what it learnt meanwhile, this one carries under the old key and
keeps the new: at an agreement in every transition n of them carry n - 1 symbols, twice as many.

| state | test | next state | the sender's next ciphertext symbol | the receiver |
|---|---|---|---|---|
| 1 | agreed | 2, keeps the key | m[p] + key, p += 1 | keeps the key |
| 1 | not agreed | 1 | random | ignores the ciphertext symbol |
| 2 | agreed | 2, keeps the new key | m[p] + new key, p += 1 | m[p] = ciphertext symbol - old key |
| 2 | not agreed | 1, drops the key | random | m[p] = ciphertext symbol - key, p += 1 |

Carry first, then test. A key still serves one message symbol, that of the very next transition.
"""

from typing import TYPE_CHECKING, Any, ClassVar

from protocol.agreement import NO_SYMBOL
from protocol.schemes.base import Carries, Carry, Scheme, check_verdict
from protocol.schemes.switched import INITIAL, MESSAGE, TEST, State, check_state

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class Pipelined(Scheme[State]):
    """Test and carry at once."""

    name: ClassVar[str] = "pipelined"
    version: ClassVar[int] = 1
    initial = INITIAL

    def advance(self, state: State, verdict: int) -> tuple[State, Carry]:
        """The verdict's key is held; the key held before is spent on this transition."""
        check_verdict(verdict, self.alphabet)
        check_state(state, self.alphabet)
        return State(TEST if verdict == NO_SYMBOL else MESSAGE, verdict), Carry(verdict, state.key)

    def pad(self, state: State) -> int:
        """The key held, in state 2."""
        return state.key

    def tests(self, state: State) -> bool:  # noqa: ARG002
        """In both states."""
        return True

    def advance_many(self, verdicts: "NDArray[np.integer[Any]]") -> Carries:
        """Every agreement counts; the key of the transition before is this one's pad."""
        import numpy as np

        pad = np.full_like(verdicts, NO_SYMBOL)
        pad[1:] = verdicts[:-1]
        return Carries(verdicts, pad, np.ones(verdicts.shape, dtype=bool))
