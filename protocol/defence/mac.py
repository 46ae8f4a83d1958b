"""`mac`: a one-time tag of 32 bits on each message, a polynomial over GF(2^32) under a pad.

A message of w words of 32 bits is forged with probability at most (w + 1) / 2^32 a try, whatever
the forger can compute (Wegman and Carter, 1981; den Boer, 1993): a measurement of two states, with
its step, has w = 6 and 1.6e-9. A pad serves one message. The point serves a session: while the pads
are secret no tag says anything of it, and q tries pass with probability at most q (w + 1) / 2^32.

Against who rewrites messages nothing else is needed. What a spoofed sensor says is tagged as well.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, ClassVar, Final, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import Array, Integers
from protocol.defence.base import WORD_BITS, Defence, Opened, Wire, Words

Number = TypeVar("Number", int, NDArray[Any])


class Field(NamedTuple):
    """GF(2^bits), its elements as bits of numbers.

    ``polynomial`` is irreducible, its leading term included.
    """

    bits: int
    polynomial: int

    def multiply(self, a: Number, b: Number) -> Number:
        """The product, of numbers or element by element; the same operations for all values."""
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


def forging(words: int, field: Field = TAGS) -> float:
    """The most that one try at a message of so many words can succeed with."""
    return float((words + 1) / 2**field.bits)


@lru_cache(maxsize=8)
def _times(point: int) -> tuple[tuple[int, ...], ...]:
    """A point's products with each byte at each of four places: one multiplication is four of
    these."""
    out = []
    for place in range(0, WORD_BITS, 8):
        row = [0]
        for bit in range(8):
            basis = TAGS.multiply(point, 1 << (place + bit))
            row += [basis ^ value for value in row]
        out.append(tuple(row))
    return tuple(out)


def _hashed(point: int, words: Sequence[int]) -> int:
    """:meth:`Field.hashed` of numbers, by tables."""
    a, b, c, d = _times(point)
    total = 0
    for word in (*words, len(words)):
        total ^= word
        total = a[total & 255] ^ b[total >> 8 & 255] ^ c[total >> 16 & 255] ^ d[total >> 24]
    return total


def tag_of(point: Words, pad: Words, words: Words) -> Words:
    """Tags of messages, shapes (...,), (...,) and (..., w) to (...,)."""
    if point.ndim == 0:
        return np.asarray(_hashed(int(point), words.tolist()) ^ int(pad), np.uint32)
    wide = [words[..., i].astype(np.uint64) for i in range(words.shape[-1])]
    value = TAGS.hashed(point.astype(np.uint64), wide)
    return (value ^ pad).astype(np.uint32)


class Mac(Defence):
    """Tags each message: a point is the session's key, a pad each message's."""

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

    def tag(self, session: Words, step: Integers, words: Words) -> Words:
        """The hash at the session's point, under the message's pad."""
        return tag_of(session[..., 0], step[..., 0].astype(np.uint32), words)

    def _tag(self, k: int, session: Words, step: Integers, x: Array) -> Words:
        """Of the step, as two words, and the states, as two words each."""
        said = np.ascontiguousarray(x, "<f8").view("<u4")
        when = np.broadcast_to(np.array([k & 0xFFFF_FFFF, k >> 32], "<u4"), (*x.shape[:-1], 2))
        words = np.concatenate((when, said), axis=-1)
        return self.tag(session, step, words)
