"""Hypotheses that say the same from here on, taken together; and messages drawn from all of them.

Two beginnings of a message whose last characters and words are the same go on alike. So at the end
of each byte they become one, of their weights together, and a graph of bytes remembers where each
came from. A few thousand of these stand for more beginnings than could be followed one by one.
Afterwards messages are drawn from the graph by their weights, their halves are put together anew
wherever the check allows it, and what fits best is judged by its own check.

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

from protocol.arrays import Array, Indices, Narrow
from protocol.schemes.framing import CHECK_BYTES, LENGTH_BYTES
from tap_service.inference.english import distinct
from tap_service.inference.lattice import Lattice
from tap_service.inference.message_beam import NEGLIGIBLE, Beam

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


DRAWN: Final = 120_000
"""Messages drawn from a graph."""

HEATS: Final = (1.0, 0.6, 0.35)
"""Powers of their weights by which they are drawn, a part by each: the unlikely ones too."""


FAINT: Final = 1e-12
"""Share of the likeliest node's weight up to which one is left out while a check is judged."""


@dataclass(frozen=True)
class Layer:
    """The graph's arcs at the end of one byte, in the order of the nodes that they lead to.

    Parameters
    ----------
    before : integer array
        Node that each arc comes from, in the layer before.
    byte : integer array
    gain : array
        Log weight of the arc over that node's.
    cumulated : tuple of array
        Share of the arcs into the node to the power of each of :data:`HEATS`, cumulated, plus the
        node's number.
    """

    before: Indices
    byte: NDArray[np.uint8]
    gain: Array
    cumulated: tuple[Array, ...]


class Graph:
    """Where the hypotheses of a beam came from, byte by byte."""

    def __init__(self) -> None:
        self._layers: list[Layer] = []
        self._scores = np.zeros(0)
        self._first = np.zeros(0)

    def begin(self, beam: Beam) -> None:
        """With these hypotheses, each a node."""
        beam.node = np.arange(len(beam.level))
        self._first = self._scores = beam.score.copy()

    def merge(self, beam: Beam) -> None:
        """Take together what goes on alike."""
        text, shares = beam.state
        first, node = distinct(beam.length, text.last, text.word, text.before)
        order = np.argsort(node, kind="stable")
        at = np.searchsorted(node[order], np.arange(len(first)))
        top = np.maximum.reduceat(beam.score[order], at)
        share = np.exp(beam.score - top[node])
        total = np.add.reduceat(share[order], at)
        share /= total[node]
        mean = np.zeros((len(first), shares.shape[1]))
        np.add.at(mean, node, share[:, None] * shares)
        ends = np.append(at[1:], len(order)) - 1
        drawn: list[Array] = []
        for heat in HEATS:
            flat = share[order] ** heat
            flat = flat / np.add.reduceat(flat, at)[node[order]]
            cumulated = np.cumsum(flat)
            cumulated -= (cumulated - flat)[at][node[order]]
            cumulated[ends] = 1.0
            drawn.append(np.minimum(cumulated, 1.0) + node[order])
        rows = np.arange(len(node))
        byte = beam.text[rows, np.maximum(beam.count - 1, 0)]
        gain = beam.score - self._scores[beam.node]
        self._layers.append(
            Layer(
                beam.node[order],
                byte[order],
                gain[order],
                tuple(drawn),
            )
        )
        # the best one stands for all; levels and nodes of the lattice add up
        best = np.lexsort((-beam.score, node))[at]
        level = np.maximum.reduceat(beam.level[order], at)
        weight = np.exp(beam.level - level[node])
        alpha = np.zeros((len(first), beam.alpha.shape[1]))
        np.add.at(alpha, node, weight[:, None] * beam.alpha)
        beam.take(best)
        beam.state = beam.state._replace(shares=mean)
        scale = np.maximum(alpha.max(axis=1), 1e-300)  # one that nothing heard allows has none
        beam.alpha, beam.level = alpha / scale[:, None], level + np.log(scale)
        beam.score = top + np.log(total)
        beam.node = np.arange(len(first))
        self._scores = beam.score.copy()

    def draw(self, nodes: Indices, weights: Array, rng: np.random.Generator, count: int) -> "Drawn":
        """Messages drawn from ``nodes`` of log ``weights``."""
        part = count // len(HEATS)
        count = part * len(HEATS)
        node = np.empty(count, dtype=np.intp)
        parts = [slice(i * part, (i + 1) * part) for i in range(len(HEATS))]
        for heat, rows in zip(HEATS, parts, strict=True):
            share = np.exp(heat * (weights - weights.max())).cumsum()
            at = (np.arange(part) + rng.random(part)) * (share[-1] / part)
            node[rows] = nodes[np.minimum(np.searchsorted(share, at), len(nodes) - 1)]
        places = len(self._layers)
        # a place at a time lies in one piece
        text = np.zeros((places, count), dtype=np.uint8)
        passed = np.zeros((places + 1, count), dtype=np.int32)
        score = np.zeros((places + 1, count))
        passed[places] = node
        for place in range(places - 1, -1, -1):
            layer = self._layers[place]
            wanted = node + rng.random(count)
            arc = np.concatenate(
                [np.searchsorted(c, wanted[r]) for c, r in zip(layer.cumulated, parts, strict=True)]
            )
            arc = np.minimum(arc, len(layer.before) - 1)
            text[place] = layer.byte[arc]
            score[place + 1] = layer.gain[arc]
            node = layer.before[arc]
            passed[place] = node
        score[0] = self._first[node]
        for place in range(places):  # in place: a sum in another array would be as large again
            score[place + 1] += score[place]
        return Drawn(text.T, score.T, passed.T)


@dataclass(frozen=True)
class Drawn:
    """Messages that were drawn.

    Parameters
    ----------
    texts : array, shape (N, bytes)
    scores : array, shape (N, bytes + 1)
        Log weight up to each place.
    nodes : integer array, shape (N, bytes + 1)
        The graph's nodes that each passes.
    """

    texts: NDArray[np.uint8]
    scores: Array
    nodes: NDArray[np.int32]

    def middle(self) -> int:
        """The place about the middle at which most messages meet."""
        places = self.texts.shape[1]
        near = range(int(0.4 * places), max(int(0.6 * places), int(0.4 * places)) + 1)
        met = [float((np.bincount(self.nodes[:, p]).astype(float) ** 2).sum()) for p in near]
        return near[int(np.argmax(met))]

    def halves(self, place: int) -> tuple[Halves, Halves, Indices]:
        """The distinct halves before and after a place, and the nodes where the latter end."""
        at, whole = self.nodes[:, place].astype(np.intp), self.scores
        first, _ = Halves(self.texts[:, :place], whole[:, place], at).distinct()
        rest = Halves(self.texts[:, place:], whole[:, -1] - whole[:, place], at)
        second, rows = rest.distinct()
        return first, second, self.nodes[rows, -1].astype(np.intp)


def check_symbols(
    lattice: Lattice, alpha: Array, low: int, ahead: Narrow, count: int
) -> Array | None:
    """Probability of each symbol of a check of ``count``, whatever the check, shape (count, M).

    Parameters
    ----------
    alpha : array, shape (nodes,)
        Of the window from step ``low`` on.
    ahead : array, shape (symbols + 1, K + 1, E)
        Log weight ahead of the nodes, by symbols that are missing; more than the transcript holds
        are as its last row.
    """
    out = np.empty((count, lattice.size))
    E = lattice.states
    for j in range(count):
        matrices = lattice.window(low, len(alpha) // E)
        low += 1
        moved = np.stack([alpha @ matrix for matrix in matrices])
        level = _ahead_of(moved, ahead[min(count - 1 - j, len(ahead) - 1)], low, E)
        if not np.isfinite(level).any():
            return None
        out[j] = np.exp(level - level.max())
        alpha = moved.mean(axis=0)
        alpha /= alpha.max()
        used = np.flatnonzero(alpha.reshape(-1, E).max(axis=1) > NEGLIGIBLE)
        alpha, low = alpha[used[0] * E : (used[-1] + 1) * E], low + int(used[0])
    shares: Array = out / out.sum(axis=1, keepdims=True)
    return shares


def judge(
    lattice: Lattice,
    texts: NDArray[np.uint8],
    alpha: Array,
    low: int,
    ahead: Narrow,
    digits: int,
) -> tuple[Array, Array, int]:
    """By how much the check of each text fits better than any check.

    Parameters
    ----------
    lattice : Lattice
    texts : array, shape (N, bytes)
    alpha : array, shape (N, nodes)
        Of the window from step ``low`` on.
    low : int
    ahead : array, shape (symbols + 1, K + 1, E)
        Log weight ahead of the nodes from step 0 on, by symbols that are missing.
    digits : int
        Symbols of a byte.

    Returns
    -------
    gain : array, shape (N,)
        Log weights.
    alpha : array, shape (N, nodes)
        After the check.
    low : int
        First step of its window.
    """
    size, E = lattice.size, lattice.states
    length = texts.shape[1].to_bytes(LENGTH_BYTES, "big")
    begun = zlib.crc32(length)
    checks = b"".join(
        zlib.crc32(row.tobytes(), begun).to_bytes(CHECK_BYTES, "big") for row in texts
    )
    table = np.frombuffer(checks, dtype=np.uint8).reshape(-1, CHECK_BYTES).astype(np.intp)
    total = digits * CHECK_BYTES
    level = -_ahead_of(alpha, ahead[min(total, len(ahead) - 1)], low, E)
    for j in range(total):
        matrices = lattice.window(low, alpha.shape[1] // E)
        symbol = table[:, j // digits] // size ** (digits - 1 - j % digits) % size
        moved = np.empty((len(alpha), matrices.shape[2]))
        for m in range(size):
            mine = symbol == m
            moved[mine] = alpha[mine] @ matrices[m]
        low += 1
        scale = np.maximum(moved.max(axis=1), 1e-300)
        level += np.log(scale)
        by_step = (moved / scale[:, None]).max(axis=0).reshape(-1, E).max(axis=1)
        used = np.flatnonzero(by_step > FAINT)
        if not len(used):
            break
        first, last = int(used[0]), int(used[-1])
        alpha = (moved / scale[:, None])[:, first * E : (last + 1) * E]
        low += first
    return level + _ahead_of(alpha, ahead[0], low, E), alpha, low


def _ahead_of(alpha: Array, ahead: Narrow, low: int, states: int) -> Array:
    """Log weight of what lies ahead of each row of ``alpha``."""
    count = alpha.shape[1] // states
    rows = np.full((count, states), -np.inf)
    have = ahead[low : low + count]
    rows[: len(have)] = have
    flat = rows.ravel()
    top = float(flat.max())
    if top == -np.inf:
        return np.full(len(alpha), -np.inf)
    with np.errstate(divide="ignore"):
        out: Array = np.log(alpha @ np.exp(flat - top)) + top
    return out
