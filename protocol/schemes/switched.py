"""The two automata of the paper's Figs. 5 and 6, as complete tables and pure step functions.

Time is counted in transitions: offers that the plant really applied. Both automata advance once a
transition, in order, and never otherwise. State 1 tests for an agreement; state 2 carries a message
symbol under the key just agreed, and is itself not tested.
"""

from typing import Final, NamedTuple

from protocol.agreement import NO_SYMBOL

TEST: Final = 1
MESSAGE: Final = 2


class Row(NamedTuple):
    """One arrow: in ``state``, on ``event``, go to ``next_state`` and do ``action``."""

    state: int
    event: str
    next_state: int
    action: str


AGREED: Final = "agreed"
NOT_AGREED: Final = "not agreed"

SENDER: Final[tuple[Row, ...]] = (
    Row(TEST, AGREED, MESSAGE, "keep key; next cipher = m[p] + key, p += 1"),
    Row(TEST, NOT_AGREED, TEST, "next cipher = fresh random symbol"),
    Row(MESSAGE, AGREED, TEST, "drop key; next cipher = fresh random symbol"),
    Row(MESSAGE, NOT_AGREED, TEST, "drop key; next cipher = fresh random symbol"),
)
"""Sender (Fig. 6a): what transition j - 1 makes of the state in which transition j is offered."""

RECEIVER: Final[tuple[Row, ...]] = (
    Row(TEST, AGREED, MESSAGE, "keep key"),
    Row(TEST, NOT_AGREED, TEST, "ignore the cipher symbol"),
    Row(MESSAGE, AGREED, TEST, "m[p] = cipher - key, p += 1; drop key"),
    Row(MESSAGE, NOT_AGREED, TEST, "m[p] = cipher - key, p += 1; drop key"),
)
"""Receiver (Fig. 6b): what transition j makes of the state it was applied in."""

_NEXT_SENDER = {(row.state, row.event): row.next_state for row in SENDER}
_NEXT_RECEIVER = {(row.state, row.event): row.next_state for row in RECEIVER}


class State(NamedTuple):
    """An automaton's state s and the key symbol it holds (:data:`NO_SYMBOL` in state 1)."""

    s: int
    key: int


INITIAL: Final = State(TEST, NO_SYMBOL)


def _check(state: State, symbol: int, size: int) -> str:
    if state.s == TEST:
        if state.key != NO_SYMBOL:
            raise ValueError(f"state: got key {state.key} in state 1, expected none")
    elif state.s != MESSAGE:
        raise ValueError(f"state: got {state.s}, expected {TEST} or {MESSAGE}")
    elif not 0 <= state.key < size:
        raise ValueError(f"state: got key {state.key}, expected 0 to {size - 1} in state 2")
    if not NO_SYMBOL <= symbol < size:
        raise ValueError(f"symbol: got {symbol}, expected -1 to {size - 1}")
    return NOT_AGREED if symbol == NO_SYMBOL else AGREED


def advance_sender(state: State, symbol: int, size: int) -> State:
    """The sender's state after a transition on which the test returned ``symbol``.

    In state 2 the transition is not tested and ``symbol`` is ignored.

    Raises
    ------
    ValueError
        When the state or the symbol is not one of the table's; nothing has changed.
    """
    event = _check(state, symbol, size)
    following = _NEXT_SENDER[state.s, event]
    return State(following, symbol if following == MESSAGE else NO_SYMBOL)


def advance_receiver(state: State, symbol: int, cipher: int, size: int) -> tuple[State, int]:
    """The receiver's state after a transition, and the message symbol it recovered (or -1).

    Raises
    ------
    ValueError
        When the state, the symbol or the cipher symbol is not one of the table's.
    """
    event = _check(state, symbol, size)
    if not 0 <= cipher < size:
        raise ValueError(f"cipher: got {cipher}, expected 0 to {size - 1}")
    following = _NEXT_RECEIVER[state.s, event]
    recovered = decrypt(cipher, state.key, size) if state.s == MESSAGE else NO_SYMBOL
    return State(following, symbol if following == MESSAGE else NO_SYMBOL), recovered


def encrypt(message_symbol: int, key: int, size: int) -> int:
    """One-time pad over ``size`` symbols: addition modulo M, exclusive or for M = 2."""
    return (message_symbol + key) % size


def decrypt(cipher: int, key: int, size: int) -> int:
    """Inverse of :func:`encrypt`."""
    return (cipher - key) % size
