"""Hypotheses that say the same from here on, taken together; and messages drawn from all of them.

Two beginnings of a message whose last characters and words are the same go on alike. So at the end
of each byte they become one, of their weights together, and a graph of bytes remembers where each
came from. A few thousand of these stand for more beginnings than could be followed one by one.
Afterwards messages are drawn from the graph by their weights, and each is judged by its own check.
"""

import zlib
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import Array, Indices
from protocol.schemes.framing import CHECK_BYTES, LENGTH_BYTES
from tap_service.inference.lattice import Lattice
from tap_service.inference.message_beam import Beam

DRAWN: Final = 40_000
"""Messages drawn from a graph."""

ROOM: Final = 1_000_000
"""Messages times nodes of the lattice at most."""


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
    cumulated : array
        Share of the arcs into the node, cumulated, plus the node's number.
    """

    before: Indices
    byte: NDArray[np.uint8]
    gain: Array
    cumulated: Array


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
        key = np.stack([beam.length, beam.at.last, beam.at.word, beam.at.before])
        _, first, node = np.unique(key, axis=1, return_index=True, return_inverse=True)
        node = node.reshape(-1)
        order = np.argsort(node, kind="stable")
        at = np.searchsorted(node[order], np.arange(len(first)))
        top = np.maximum.reduceat(beam.score[order], at)
        share = np.exp(beam.score - top[node])
        total = np.add.reduceat(share[order], at)
        share /= total[node]
        cumulated = np.cumsum(share[order])
        cumulated -= (cumulated - share[order])[at][node[order]]
        cumulated[np.append(at[1:], len(order)) - 1] = 1.0
        rows = np.arange(len(node))
        byte = beam.text[rows, np.maximum(beam.count - 1, 0)]
        gain = beam.score - self._scores[beam.node]
        self._layers.append(
            Layer(
                beam.node[order],
                byte[order],
                gain[order],
                np.minimum(cumulated, 1.0) + node[order],
            )
        )
        # the best one stands for all; levels and nodes of the lattice add up
        best = np.lexsort((-beam.score, node))[at]
        level = np.maximum.reduceat(beam.level[order], at)
        weight = np.exp(beam.level - level[node])
        alpha = np.zeros((len(first), beam.alpha.shape[1]))
        np.add.at(alpha, node, weight[:, None] * beam.alpha)
        beam.take(best)
        scale = alpha.max(axis=1)
        beam.alpha, beam.level = alpha / scale[:, None], level + np.log(scale)
        beam.score = top + np.log(total)
        beam.node = np.arange(len(first))
        self._scores = beam.score.copy()

    def draw(
        self, nodes: Indices, weights: Array, rng: np.random.Generator, count: int
    ) -> tuple[NDArray[np.uint8], Array, Indices]:
        """Distinct messages drawn from ``nodes`` of log ``weights``: they, log weights, nodes."""
        share = np.exp(weights - weights.max()).cumsum()
        at = (np.arange(count) + rng.random(count)) * (share[-1] / count)
        node = nodes[np.minimum(np.searchsorted(share, at), len(nodes) - 1)]
        last = node.copy()
        text = np.zeros((count, len(self._layers)), dtype=np.uint8)
        score = np.zeros(count)
        for place in range(len(self._layers) - 1, -1, -1):
            layer = self._layers[place]
            arc = np.searchsorted(layer.cumulated, node + rng.random(count))
            arc = np.minimum(arc, len(layer.before) - 1)
            text[:, place] = layer.byte[arc]
            score += layer.gain[arc]
            node = layer.before[arc]
        score += self._first[node]
        _, first = np.unique(text, axis=0, return_index=True)
        return text[first], score[first], last[first]


def judge(
    lattice: Lattice,
    texts: NDArray[np.uint8],
    alpha: Array,
    low: int,
    ahead: Array,
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
    level = -_ahead_of(alpha, ahead[total], low, E)
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
        used = np.flatnonzero((moved / scale[:, None]).max(axis=0).reshape(-1, E).max(axis=1))
        if not len(used):
            break
        first, last = int(used[0]), int(used[-1])
        alpha = (moved / scale[:, None])[:, first * E : (last + 1) * E]
        low += first
    return level + _ahead_of(alpha, ahead[0], low, E), alpha, low


def _ahead_of(alpha: Array, ahead: Array, low: int, states: int) -> Array:
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
