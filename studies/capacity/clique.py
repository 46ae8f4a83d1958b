"""Exact largest cliques of small graphs, by branch and bound with a colouring as the bound.

A graph is a list of integers: bit w of entry v says that v and w are neighbours. The method is that
of Tomita and Seki (2003): vertices are coloured greedily, and a branch whose colours cannot make it
longer than the best clique so far is cut.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Clique(NamedTuple):
    """A clique, and whether the search proved that none is larger."""

    vertices: tuple[int, ...]
    proved: bool


def adjacency(edges: NDArray[np.bool_]) -> list[int]:
    """The rows of a symmetric matrix without a diagonal, shape (V, V), as integers."""
    packed = np.packbits(edges, axis=1, bitorder="little")
    return [int.from_bytes(row.tobytes(), "little") for row in packed]


def largest_clique(
    neighbours: Sequence[int], *, at_least: int = 0, most_branches: int = 2_000_000
) -> Clique:
    """A largest clique.

    Parameters
    ----------
    neighbours : sequence of int
        One integer a vertex; bit v of entry v is not set.
    at_least : int
        Only cliques larger than this are of interest: without one the answer is empty.
    most_branches : int
        The search ends here with the best so far, unproved.
    """
    search = _Search(neighbours, at_least, most_branches)
    search.expand((1 << len(neighbours)) - 1, [])
    return Clique(tuple(sorted(search.best)), search.branches < most_branches)


class _Search:
    def __init__(self, neighbours: Sequence[int], at_least: int, most_branches: int) -> None:
        self.neighbours = neighbours
        self.best: list[int] = []
        self.size = at_least
        self.most = most_branches
        self.branches = 0

    def expand(self, candidates: int, clique: list[int]) -> None:
        """Every clique that goes on from ``clique`` within ``candidates``."""
        order, colours = self._colour(candidates)
        for v, colour in zip(reversed(order), reversed(colours), strict=True):
            if len(clique) + colour <= self.size or self.branches >= self.most:
                return
            self.branches += 1
            clique.append(v)
            rest = candidates & self.neighbours[v]
            if rest:
                self.expand(rest, clique)
            elif len(clique) > self.size:
                self.size, self.best = len(clique), clique.copy()
            clique.pop()
            candidates &= ~(1 << v)

    def _colour(self, candidates: int) -> tuple[list[int], list[int]]:
        """Vertices in order of colour; a colour's vertices are no neighbours of each other."""
        order: list[int] = []
        colours: list[int] = []
        colour = 0
        while candidates:
            colour += 1
            free = candidates
            while free:
                bit = free & -free
                v = bit.bit_length() - 1
                order.append(v)
                colours.append(colour)
                candidates ^= bit
                free &= ~(bit | self.neighbours[v])
        return order, colours
