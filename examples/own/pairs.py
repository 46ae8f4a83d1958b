"""`pairs`: gathers two keys, then carries two message symbols in a row."""

from typing import NamedTuple

from protocol.agreement import NO_SYMBOL
from protocol.schemes.base import COVER, Carry, Scheme, check_verdict


class State(NamedTuple):
    s: int  # 1, 2: gathering; 3, 4: spending
    first: int
    second: int


class Pairs(Scheme[State]):
    name = "pairs"
    version = 1
    initial = State(1, NO_SYMBOL, NO_SYMBOL)

    def advance(self, state, verdict):
        check_verdict(verdict, self.alphabet)
        s, first, second = state
        if s >= 3:  # spends: the verdict is not looked at
            after = State(4, second, NO_SYMBOL) if s == 3 else self.initial
            return after, Carry(agreed=NO_SYMBOL, pad=first)
        if verdict == NO_SYMBOL:
            return state, COVER
        after = State(2, verdict, NO_SYMBOL) if s == 1 else State(3, first, verdict)
        return after, Carry(agreed=verdict, pad=NO_SYMBOL)

    def pad(self, state):
        return state.first if state.s >= 3 else NO_SYMBOL

    def tests(self, state):
        return state.s < 3
