"""What a scheme is: the one map that both ends, the engine, the checker and the taps ask.

Time is counted in transitions: offers that the plant really applied. A scheme advances once a
transition, in order, and never otherwise. It is public, as every algorithm here is: what it hides
lies in the verdicts and the keys. Both ends hold the same state and differ only in who adds the key
to a message symbol and who subtracts it.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Final, Generic, NamedTuple, TypeVar

from protocol.agreement import NO_SYMBOL

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

S = TypeVar("S", bound=tuple[int, ...])


class Carry(NamedTuple):
    """What one applied transition does, for both ends alike.

    Parameters
    ----------
    agreed : int
        The key symbol gained, or :data:`~protocol.agreement.NO_SYMBOL`.
    pad : int
        The key symbol under which the transition's ciphertext symbol travelled, or
        :data:`~protocol.agreement.NO_SYMBOL` where that was a random cover symbol.
    """

    agreed: int
    pad: int


class Carries(NamedTuple):
    """What :class:`Carry` says, of many transitions; time is the first axis.

    Parameters
    ----------
    agreed, pad : integer array, shape (steps, ...)
    tested : bool array, shape (steps, ...)
        Where the verdict counted (:meth:`Scheme.tests`).
    """

    agreed: "NDArray[np.integer[Any]]"
    pad: "NDArray[np.integer[Any]]"
    tested: "NDArray[np.bool_]"


class Scheme(ABC, Generic[S]):
    """Which transitions agree on a key symbol, and which carry a message symbol under which key.

    A subclass sets ``name`` and ``version``, which both enter the fingerprint (with the SHA-256 of
    the file, where a file of the user's is named), and ``initial``. Its
    state is a NamedTuple of integers whose first one, ``s``, numbers what the automaton is doing;
    it is journalled as it is.

    Parameters
    ----------
    alphabet : int
        M, the number of symbols.
    """

    name: ClassVar[str]
    version: ClassVar[int]
    initial: S
    from_stream: ClassVar[bool] = False
    """Whether its pads are digits of the key stream, in place of keys that transitions agree on."""
    corrects: ClassVar[bool] = False
    """Whether the plant takes its coin for the verdict, and corrects by what it hears in clear.

    The two ends' states may then differ until a word of verdicts is corrected. Both gain the keys
    of a word where they spend them."""

    def __init__(self, alphabet: int) -> None:
        self.alphabet = alphabet
        self._followed: dict[tuple[S, int], tuple[S, Carry]] = {}

    def follow(self, state: S, verdict: int) -> tuple[S, Carry]:
        """:meth:`advance` from a cache, so that it takes equally long in every state.

        Raises
        ------
        ValueError
            As :meth:`advance` does.
        """
        found = self._followed.get((state, verdict))
        if found is None:
            if len(self._followed) >= FOLLOWED:
                self._followed.clear()
            found = self._followed[state, verdict] = self.advance(state, verdict)
        return found

    @abstractmethod
    def advance(self, state: S, verdict: int) -> tuple[S, Carry]:
        """The state after a transition on which the test returned ``verdict``, and what it did.

        Raises
        ------
        ValueError
            When the state is not one of the scheme's, or the verdict neither
            :data:`~protocol.agreement.NO_SYMBOL` nor in range(M).
        """

    @abstractmethod
    def pad(self, state: S) -> int:
        """The key for the ciphertext symbol of the transition to come, or NO_SYMBOL for a cover."""

    @abstractmethod
    def tests(self, state: S) -> bool:
        """Whether the verdict of the transition to come can make a difference."""

    def clear(self, state: S) -> int:  # noqa: ARG002
        """What the transition to come carries in clear, or NO_SYMBOL; of one that corrects."""
        return NO_SYMBOL

    def hear(self, state: S, cipher: int) -> S:  # noqa: ARG002
        """The plant's state once it has this transition's symbol; of one that corrects."""
        return state

    def differs(self, state: S) -> bool:  # noqa: ARG002
        """Whether the plant knows that its word is not the controller's: the session ends."""
        return False

    def restore(self, values: Sequence[int]) -> S:
        """The state from its journalled values; the initial state where there are none."""
        make: Callable[..., S] = type(self.initial)
        return make(*values) if values else self.initial


FOLLOWED: Final = 4096
"""Transitions that a scheme caches. A scheme with more is computed again."""

COVER: Final = Carry(NO_SYMBOL, NO_SYMBOL)
"""A transition that agrees on nothing and carries nothing."""


def check_verdict(verdict: int, alphabet: int) -> None:
    """Refuse what is no verdict.

    Raises
    ------
    ValueError
        When it is neither :data:`~protocol.agreement.NO_SYMBOL` nor in range(``alphabet``).
    """
    if not NO_SYMBOL <= verdict < alphabet:
        raise ValueError(f"verdict: got {verdict}, expected -1 to {alphabet - 1}")


def encrypt(message_symbol: int, key: int, size: int) -> int:
    """One-time pad over ``size`` symbols: addition modulo M, exclusive or for M = 2."""
    return (message_symbol + key) % size


def decrypt(cipher: int, key: int, size: int) -> int:
    """Inverse of :func:`encrypt`."""
    return (cipher - key) % size
