"""Any scheme over arrays: its states numbered, what each verdict does to them looked up."""

from typing import Any, Final

import numpy as np

from protocol.agreement import NO_SYMBOL
from protocol.arrays import Integers
from protocol.schemes.base import Carries, Scheme

ROOM: Final = 16
"""States that a table has room for at first; it doubles."""


class StateTable:
    """A scheme's states by number, in order of their appearance, 0 the initial one.

    States are found as they are reached, so that a scheme need not list them.

    Parameters
    ----------
    scheme : Scheme

    Attributes
    ----------
    pad : integer array
        Of each state known, :meth:`~protocol.schemes.base.Scheme.pad`.
    tests : bool array
        Of each state known, :meth:`~protocol.schemes.base.Scheme.tests`.
    """

    def __init__(self, scheme: Scheme[Any]) -> None:
        self.scheme = scheme
        self._states: list[Any] = []
        self._numbers: dict[Any, int] = {}
        outcomes = scheme.alphabet + 1
        self.pad = np.full(ROOM, NO_SYMBOL)
        self.tests = np.zeros(ROOM, dtype=bool)
        self._following = np.full((ROOM, outcomes), -1, dtype=np.int32)
        self._agreed = np.full((ROOM, outcomes), NO_SYMBOL)
        self._closed = False  # whether what follows every state known is known
        self._number(scheme.initial)

    def __deepcopy__(self, memo: dict[int, Any]) -> "StateTable":
        return self  # it only grows, and the same way for everybody

    def _double(self) -> None:
        """Double the room for states."""
        self.pad, self.tests, self._following, self._agreed = (
            np.concatenate([part, np.full_like(part, -1)])
            for part in (self.pad, self.tests, self._following, self._agreed)
        )

    def _number(self, state: Any) -> int:
        number = self._numbers.get(state)
        if number is None:
            number = self._numbers[state] = len(self._states)
            if number == len(self.pad):
                self._double()
            self._states.append(state)
            self.pad[number] = self.scheme.pad(state)
            self.tests[number] = self.scheme.tests(state)
        return number

    def following(self, states: Integers, verdicts: Integers) -> Integers:
        """The numbers of the states that follow.

        Parameters
        ----------
        states, verdicts : integer array of one shape
        """
        at = states * self._following.shape[1] + (verdicts + 1)  # one index: half the time of two
        following: Integers = self._following.ravel().take(at)
        if not self._closed and following.size and following.min() < 0:
            for number in np.unique(states):
                self._expand(int(number))
            self._closed = bool((self._following[: len(self._states), 0] >= 0).all())
            following = self._following.ravel().take(at)
        return following

    def all_following(self) -> Integers:
        """What follows every state that there is under each verdict, shape (states, 1 + M)."""
        number = 0
        while number < len(self._states):
            self._expand(number)
            number += 1
        return self._following[:number]

    def agreed(self, states: Integers, verdicts: Integers) -> Integers:
        """The key symbols gained, of states and verdicts that were followed before."""
        agreed: Integers = self._agreed[states, verdicts + 1]
        return agreed

    def _expand(self, number: int) -> None:
        if self._following[number, 0] >= 0:
            return
        for verdict in range(NO_SYMBOL, self.scheme.alphabet):
            after, carry = self.scheme.advance(self._states[number], verdict)
            following = self._number(after)  # may make room: look the arrays up afterwards
            self._following[number, verdict + 1] = following
            self._agreed[number, verdict + 1] = carry.agreed


def advance_many(scheme: Scheme[Any], verdicts: Integers) -> Carries:
    """Advance over many runs at once, each from the initial state.

    Parameters
    ----------
    scheme : Scheme
    verdicts : integer array, shape (steps, ...)
    """
    table = StateTable(scheme)
    states = np.zeros((len(verdicts) + 1, *verdicts.shape[1:]), dtype=np.int32)
    for before, verdict, after in zip(states, verdicts, states[1:], strict=False):
        after[...] = table.following(before, verdict)
    held = states[:-1]
    return Carries(
        table.agreed(held, verdicts).astype(verdicts.dtype),
        table.pad[held].astype(verdicts.dtype),
        table.tests[held],
    )
