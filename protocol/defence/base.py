"""What every defence is: what both ends do to a step under key that they share.

All of it is NumPy by element: the leading axes ``...`` are runs, none in a live run. A defence does
no input or output and keeps nothing. What it does beside the test that it is for is left out by
default, so that one that only looks at the transition has one method.
"""

from abc import ABC
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import Array, Flags, Integers

Words = NDArray[np.uint32]

WORD_BITS: Final = 32
"""Bits of a word of key."""


@dataclass(frozen=True, slots=True)
class Wire:
    """A measurement on the field bus.

    Parameters
    ----------
    values : ndarray, shape (..., n)
    tag : ndarray of uint32, shape (...,), optional
        None where the defence makes none.
    """

    values: Array
    tag: Words | None = None


@dataclass(frozen=True, slots=True)
class Opened:
    """What the controller makes of it.

    Parameters
    ----------
    x : ndarray, shape (..., n)
    alarm : ndarray of bool, shape (...,)
        Whether it is no message of the plant's.
    """

    x: Array
    alarm: Flags


class Defence(ABC):
    """Base of all defences.

    Attributes
    ----------
    name : str
    codes, tags : bool
        Whether it changes measurements (:meth:`encode`), and whether it tags messages, offers too
        (:meth:`tag`). One of both guards the messages of a live loop (:mod:`protocol.link.guard`).
    session_words, step_words : int
        Words of key that it takes once, and for each message, where it takes whole words.

    Parameters
    ----------
    states, candidates : int
        n and M.
    """

    name: ClassVar[str]
    codes: ClassVar[bool] = False
    tags: ClassVar[bool] = False
    session_words: int = 0
    step_words: int = 0

    def __init__(self, states: int, candidates: int) -> None:
        self.states, self.candidates = states, candidates

    @property
    def key_bits(self) -> float:
        """Bits of key that a step costs: its measurement's, and its offer's if that is tagged."""
        return float(WORD_BITS * self.step_words * (1 + self.tags))

    def session_key(self, draw: np.random.Generator, runs: tuple[int, ...]) -> Words:
        """Uniform key of a session, shape (..., session_words)."""
        return draw.integers(1 << WORD_BITS, size=(*runs, self.session_words), dtype=np.uint32)

    def step_key(self, draw: np.random.Generator, runs: tuple[int, ...]) -> Integers:
        """Uniform key of one step, shape (..., step_words)."""
        return draw.integers(1 << WORD_BITS, size=(*runs, self.step_words), dtype=np.uint32)

    def coin(self, session: Words, step: Integers) -> Integers | None:  # noqa: ARG002
        """The candidate that the plant applies, shape (...,); None: its private coin's."""
        return None

    def encode(self, k: int, session: Words, step: Integers, x: Array) -> Wire:  # noqa: ARG002
        """The plant's end: x(k), shape (..., n), as it goes out."""
        return Wire(x)

    def decode(self, k: int, session: Words, step: Integers, wire: Wire) -> Opened:  # noqa: ARG002
        """The controller's end: what came in as x(k)."""
        return Opened(wire.values, np.zeros(wire.values.shape[:-1], bool))

    def tag(self, session: Words, step: Integers, words: Words) -> Words | None:  # noqa: ARG002
        """The tag of a message, shape (...,); None: it makes none.

        Parameters
        ----------
        session, step : ndarray
            Key of the session, and of this message alone.
        words : ndarray of uint32, shape (..., w)
        """
        return None

    def alarm(self, session: Words, step: Integers, gauges: Array) -> Any:  # noqa: ARG002
        """The controller's test of a transition, shape (...,).

        Parameters
        ----------
        session, step : ndarray
            Key of the step whose offer the transition answers.
        gauges : ndarray, shape (..., M)
            g(x(k+1) - c_i) in D_c, of each candidate.

        Returns
        -------
        ndarray of bool
        """
        return np.zeros(gauges.shape[:-1], bool)

    def fails(self, gauges: Sequence[float]) -> bool:
        """:meth:`alarm` of one transition, of a test that takes no key."""
        none = np.zeros(0, np.uint32)
        return bool(self.alarm(none, none, np.asarray(gauges)))
