"""First and second halves of messages, put together wherever the check allows it.

A cyclic check is linear over two: that of a whole is the first half's, moved on by as many bytes as
the second half has, plus the second half's own. So of the symbols of the check that were heard each
second half says what the first one's must be, and the pairs that fit are found by sorting, without
a look at the others. Some ten thousand halves stand for as many millions of messages.
"""

import zlib
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import Array, Indices
from protocol.schemes.framing import LENGTH_BYTES

HEARD: Final = 0.999
"""Probability from which a symbol of the check is taken as heard."""

FITTING: Final = 2_000_000
"""Pairs that fit what was heard of the check, at most."""

JUDGED: Final = 2000
"""Of them those that are given back."""

TINY: Final = 1e-300

Texts = NDArray[np.uint8]
Words = NDArray[np.uint32]


def first_of_each(texts: Texts) -> Indices:
    """Where each of the texts, a row each, is first, in their order."""
    key = np.ascontiguousarray(texts)
    return np.unique(key.view(f"V{key.shape[1]}").ravel(), return_index=True)[1]


@dataclass(frozen=True)
class Halves:
    """Halves of messages, some of which may be followed by others.

    Parameters
    ----------
    texts : array, shape (N, bytes)
    scores : array, shape (N,)
        Log weights.
    middle : integer array, shape (N,)
        First halves can go on with the second ones of the same number.
    """

    texts: Texts
    scores: Array
    middle: Indices

    def distinct(self) -> tuple["Halves", Indices]:
        """Each once, the likeliest of each number first; and where they were."""
        middle = self.middle.astype(">i4").view(np.uint8).reshape(-1, 4)
        first = first_of_each(np.hstack([middle, self.texts]))
        first = first[np.lexsort((-self.scores[first], self.middle[first]))]
        return self.take(first), first

    def take(self, rows: Indices) -> "Halves":
        """Some of them."""
        return Halves(self.texts[rows], self.scores[rows], self.middle[rows])

    def rank(self) -> Indices:
        """The place of each among those of the same number."""
        begin = np.flatnonzero(np.append(True, self.middle[1:] != self.middle[:-1]))
        count = np.diff(np.append(begin, len(self.middle)))
        return np.arange(len(self.middle)) - np.repeat(begin, count)


def _moved(checks: Words, count: int) -> Words:
    """What ``checks`` become ``count`` bytes later, but for what these bytes add."""
    zeros = bytes(count)
    none = zlib.crc32(zeros, 0)
    out = np.zeros_like(checks)
    for bit in range(32):
        one = np.uint32(zlib.crc32(zeros, 1 << bit) ^ none)
        out ^= np.where(checks >> np.uint32(bit) & np.uint32(1), one, np.uint32(0))
    return out


def _checks(texts: Texts, begun: int) -> Words:
    return np.array([zlib.crc32(row.tobytes(), begun) for row in texts], dtype=np.uint32)


def join(first: Halves, second: Halves, symbols: Array) -> tuple[Indices, Indices, float]:
    """The likeliest pairs by halves' weights and the check's symbols.

    Parameters
    ----------
    first, second : Halves
        Distinct.
    symbols : array, shape (symbols of a check, M)
        Probability of each symbol; M is a power of two.

    Returns
    -------
    a, b : integer array
        Which of ``first`` and ``second``.
    mass : float
        Log weight, the check not looked at, of all pairs that were considered.
    """
    count, size = symbols.shape
    bits = size.bit_length() - 1
    length = first.texts.shape[1] + second.texts.shape[1]
    heard, expected = 0, 0
    for j, row in enumerate(symbols):
        at = bits * (count - 1 - j)
        if row.max() >= HEARD:
            heard |= (size - 1) << at
            expected |= int(row.argmax()) << at
    numbers = np.union1d(first.middle, second.middle)
    of_a, of_b = (
        np.searchsorted(numbers, h.middle).astype(np.uint64) << np.uint64(32)
        for h in (first, second)
    )
    one = _moved(
        _checks(first.texts, zlib.crc32(length.to_bytes(LENGTH_BYTES, "big"))),
        second.texts.shape[1],
    )
    two = _checks(second.texts, 0)
    most = len(first.middle) + len(second.middle)
    rank_a, rank_b = first.rank(), second.rank()
    while True:
        rows_a, rows_b = np.flatnonzero(rank_a < most), np.flatnonzero(rank_b < most)
        key_a = of_a[rows_a] | (one[rows_a] & np.uint32(heard)).astype(np.uint64)
        wanted = (two[rows_b] ^ np.uint32(expected)) & np.uint32(heard)
        key_b = of_b[rows_b] | wanted.astype(np.uint64)
        order = np.argsort(key_b)
        low, high = (np.searchsorted(key_b[order], key_a, side=s) for s in ("left", "right"))
        pairs = high - low
        if pairs.sum() <= FITTING:
            break
        most = max(most // 2, 1)
    a = np.repeat(np.arange(len(rows_a)), pairs)
    begin = np.cumsum(pairs) - pairs
    b = order[np.repeat(low - begin, pairs) + np.arange(len(a))]
    a, b = rows_a[a], rows_b[b]
    check = one[a] ^ two[b]
    with np.errstate(divide="ignore"):
        gains = np.log(np.maximum(symbols * size, TINY))
    score = first.scores[a] + second.scores[b]
    for j in range(count):
        at = np.uint32(bits * (count - 1 - j))
        score += gains[j, (check >> at & np.uint32(size - 1)).astype(np.intp)]
    best = np.argsort(-score)[:JUDGED]
    return a[best], b[best], _mass(first.take(rows_a), second.take(rows_b), len(numbers), numbers)


def _mass(first: Halves, second: Halves, count: int, numbers: Indices) -> float:
    """Log weight of all pairs."""
    parts = []
    top = [float(h.scores.max()) for h in (first, second)]
    for half, level in zip((first, second), top, strict=True):
        at = np.searchsorted(numbers, half.middle)
        parts.append(np.bincount(at, np.exp(half.scores - level), count))
    return float(np.log(max(float(parts[0] @ parts[1]), TINY))) + sum(top)
