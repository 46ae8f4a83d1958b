"""`switched`: the scheme of the paper's Figs. 5 and 6.

State 1 tests for an agreement; state 2 carries a message symbol under the key just agreed, and is
itself not tested. So a symbol takes two transitions at least.

- In state 1, agreed: to state 2, which holds the key; the sender's next ciphertext symbol is
  m[p] + key.
- In state 1, not agreed: it stays; the next ciphertext symbol is random, and the receiver ignores
  this one.
- In state 2, whatever the test says: to state 1; the receiver takes m[p] = ciphertext symbol - key,
  and the next ciphertext symbol is random.
"""

from typing import ClassVar, Final, NamedTuple

from protocol.agreement import NO_SYMBOL
from protocol.schemes.base import Carry, Scheme, check_verdict

TEST: Final = 1
MESSAGE: Final = 2


class SwitchedState(NamedTuple):
    """The automaton's state s and the key symbol it holds (NO_SYMBOL in state 1)."""

    s: int
    key: int


INITIAL: Final = SwitchedState(TEST, NO_SYMBOL)


def check_state(state: SwitchedState, alphabet: int) -> None:
    """Refuse what is no state of the two.

    Raises
    ------
    ValueError
        When s or the key is wrong.
    """
    if state.s == TEST:
        if state.key != NO_SYMBOL:
            raise ValueError(f"state: got key {state.key} in state 1, expected none")
    elif state.s != MESSAGE:
        raise ValueError(f"state: got {state.s}, expected {TEST} or {MESSAGE}")
    elif not 0 <= state.key < alphabet:
        raise ValueError(f"state: got key {state.key}, expected 0 to {alphabet - 1} in state 2")


class Switched(Scheme[SwitchedState]):
    """Test, then carry: both automata of Fig. 6 as one map."""

    name: ClassVar[str] = "switched"
    version: ClassVar[int] = 1
    initial = INITIAL

    def advance(self, state: SwitchedState, verdict: int) -> tuple[SwitchedState, Carry]:
        """One arrow of Fig. 6; in state 2 the verdict is not looked at."""
        check_verdict(verdict, self.alphabet)
        check_state(state, self.alphabet)
        agreed = verdict if state.s == TEST else NO_SYMBOL
        after = SwitchedState(TEST if agreed == NO_SYMBOL else MESSAGE, agreed)
        return after, Carry(agreed, state.key)

    def pad(self, state: SwitchedState) -> int:
        """The key held, in state 2."""
        return state.key

    def tests(self, state: SwitchedState) -> bool:
        """In state 1."""
        return state.s == TEST
