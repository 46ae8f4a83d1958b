"""What the study of attacks compares: what both ends do to a step under a key that they share.

The keyed coin and the residual are what a live controller tests; coding and the tag are known ideas
to stand beside them. All of it is NumPy by element: the leading axes ``...`` are runs. A defence
does no input or output and keeps nothing. What it does beside the test that it is for is left out
by default, so that one that only looks at the transition has one method.
"""

import math
from abc import ABC
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from protocol.agreement import INSIDE
from protocol.arrays import Array, Flags, Integers

Words = NDArray[np.uint32]
Number = TypeVar("Number", int, NDArray[Any])

WORD_BITS: Final = 32
"""Bits of a word of key."""

FULL: Final = 2.0**WORD_BITS


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
    session_words, step_words : int
        Words of key that it takes once, and for each message, where it takes whole words.
    tags : bool
        Whether it tags messages, offers too.

    Parameters
    ----------
    states, candidates : int
        n and M.
    """

    name: ClassVar[str]
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


class Residual(Defence):
    """x(k+1) is one that some candidate leads to with d in D_c (equation 14). No key."""

    name: ClassVar[str] = "residual"

    def alarm(self, session: Words, step: Integers, gauges: Array) -> Flags:  # noqa: ARG002
        """Whether every gauge is above 1, to rounding."""
        out: Flags = ~(gauges.min(-1) <= INSIDE)
        return out


class KeyedCoin(Defence):
    """Alarms where the keyed candidate does not explain the transition; a base-M digit a step."""

    name: ClassVar[str] = "keyed-coin"

    @property
    def key_bits(self) -> float:
        """log2(M)."""
        return math.log2(self.candidates)

    def step_key(self, draw: np.random.Generator, runs: tuple[int, ...]) -> Integers:
        """A uniform digit, shape (..., 1)."""
        return draw.integers(self.candidates, size=(*runs, 1))

    def coin(self, session: Words, step: Integers) -> Integers:  # noqa: ARG002
        """The digit."""
        return step[..., 0]

    def alarm(self, session: Words, step: Integers, gauges: Array) -> Flags:  # noqa: ARG002
        """Whether the keyed candidate's gauge is above 1, to rounding."""
        out: Flags = ~(np.take_along_axis(gauges, step, -1)[..., 0] <= INSIDE)
        return out


# --- each measurement turned by a fresh rotation of the key ---------------------------------------


def rotations(words: Integers) -> Array:
    """Rotations of the plane by 2 pi w / 2^32, shape (..., 1) to (..., 2, 2)."""
    angle = 2 * math.pi * (words[..., 0].astype(np.float64) + 0.5) / FULL
    c, s = np.cos(angle), np.sin(angle)
    return np.stack((np.stack((c, -s), -1), np.stack((s, c), -1)), -2)


def turned(S: Array, x: Array) -> Array:
    """S x, shapes (..., 2, 2) and (..., 2)."""
    out: Array = (S @ x[..., None])[..., 0]
    return out


class Coding(Defence):
    """Turns each measurement by a matrix of its own, x -> S(k) x; two states.

    Who rewrites messages must turn her correction e likewise. Turned by another matrix T it leaves
    e - S^T T e in what the controller reads, as long as 2 sin(phi / 2) abs(e) for an angle phi
    between them. So a correction within D_c goes unseen, and so does any that is made before the
    plant's end turns the reading.
    """

    name: ClassVar[str] = "coding"

    step_words = 1

    def encode(self, k: int, session: Words, step: Integers, x: Array) -> Wire:  # noqa: ARG002
        """S x."""
        return Wire(turned(rotations(step), x))

    def decode(self, k: int, session: Words, step: Integers, wire: Wire) -> Opened:  # noqa: ARG002
        """S' of what came; nothing is tested here."""
        back = np.swapaxes(rotations(step), -1, -2)
        return Opened(turned(back, wire.values), np.zeros(wire.values.shape[:-1], bool))


# --- a one-time tag of 32 bits on each message ----------------------------------------------------


class Field(NamedTuple):
    """GF(2^bits), its elements as bits of numbers.

    ``polynomial`` is irreducible, its leading term included.
    """

    bits: int
    polynomial: int

    def multiply(self, a: Number, b: Number) -> Number:
        """The product, of numbers or element by element."""
        low = self.polynomial ^ (1 << self.bits)
        mask = (1 << self.bits) - 1
        out = a & 0
        for _ in range(self.bits):
            out = out ^ (a * (b & 1))
            b = b >> 1
            a = ((a << 1) & mask) ^ (((a >> (self.bits - 1)) & 1) * low)
        return out

    def hashed(self, point: Number, words: Sequence[Number]) -> Number:
        """w_1 z^(m+1) + ... + w_m z^2 + m z at z = ``point``, words below 2^bits.

        No two texts share their coefficients, and there is no constant term, which a forger could
        shift together with the pad.
        """
        total = point & 0
        for word in words:
            total = self.multiply(total ^ word, point)
        return self.multiply(total ^ len(words), point)


TAGS: Final = Field(WORD_BITS, 0x1_0000_008D)
"""x^32 + x^7 + x^3 + x^2 + 1."""


def tag_of(point: Words, pad: Words, words: Words) -> Words:
    """Tags of messages, shapes (...,), (...,) and (..., w) to (...,)."""
    wide = [words[..., i].astype(np.uint64) for i in range(words.shape[-1])]
    value = TAGS.hashed(point.astype(np.uint64), wide)
    return (value ^ pad).astype(np.uint32)


class Mac(Defence):
    """Tags each message: a point is the session's key, a pad each message's.

    While the pads are secret no tag says anything of the point, so it serves a session.
    """

    name: ClassVar[str] = "mac"
    tags: ClassVar[bool] = True
    session_words = 1
    step_words = 1

    def encode(self, k: int, session: Words, step: Integers, x: Array) -> Wire:
        """x(k) with its tag."""
        return Wire(x, self._tag(k, session, step, x))

    def decode(self, k: int, session: Words, step: Integers, wire: Wire) -> Opened:
        """An alarm where the tag is not the message's."""
        assert wire.tag is not None
        return Opened(wire.values, wire.tag != self._tag(k, session, step, wire.values))

    def _tag(self, k: int, session: Words, step: Integers, x: Array) -> Words:
        """Of the step, as two words, and the states, as two words each."""
        said = np.ascontiguousarray(x, "<f8").view("<u4")
        when = np.broadcast_to(np.array([k & 0xFFFF_FFFF, k >> 32], "<u4"), (*x.shape[:-1], 2))
        words = np.concatenate((when, said), axis=-1)
        return tag_of(session[..., 0], step[..., 0].astype(np.uint32), words)


DEFENCES: Final[dict[str, type[Defence]]] = {
    kind.name: kind for kind in (Residual, KeyedCoin, Coding, Mac)
}
