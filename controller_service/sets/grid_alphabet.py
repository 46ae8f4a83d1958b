"""Alphabets of two inputs: the points of a grid.

The differences that the defender may mistake form a polygon. Two of its pairs of edges are those of
a parallelogram around it. On a grid with the parallelogram's half-edges as steps no two points are
mistaken. The grid may be as large as the eavesdropper's polygon allows. Where both polygons are the
same parallelogram but for its size, as with boxes of which two rows decide, no alphabet is larger.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from controller_service.sets.separation import APART, TOGETHER, AlphabetError, Separation
from protocol.arrays import Array
from protocol.convex import SetError, planar_reduce


@dataclass(frozen=True, eq=False)
class Grid:
    """Points a e_1 + b e_2 for integers a and b, and the largest of their rectangles that fit.

    Parameters
    ----------
    edges : array, shape (2, 2)
        Rows e_1 and e_2.
    columns : tuple of int
        Entry a - 1 is the most points along e_2 beside a points along e_1.
    """

    edges: Array
    columns: tuple[int, ...]

    def points(self, a: int, b: int) -> Array:
        """a points along e_1 times b along e_2, shape (a b, 2)."""
        i, j = np.meshgrid(np.arange(a, dtype=float), np.arange(b, dtype=float), indexing="ij")
        out: Array = np.stack([i.ravel(), j.ravel()], axis=1) @ self.edges
        return out


def polygon_rows(rows: Array) -> Array:
    """Irredundant rows of { v : abs(row v) <= 1 }, one of each pair of opposite edges.

    Raises
    ------
    AlphabetError
        When the set is unbounded.
    """
    both = np.vstack([rows, -rows])
    lengths = np.sqrt((both * both).sum(axis=1))
    keep = lengths > 1e-12 * lengths.max()
    try:
        p = planar_reduce(both[keep] / lengths[keep, None], 1 / lengths[keep])
    except SetError:
        raise AlphabetError(
            "plant.B: the inputs move the state along one line, expected two independent ones"
        ) from None
    scaled = p.H / p.h[:, None]
    out: Array = scaled[: len(scaled) // 2]
    return out


def grids(sep: Separation, alpha: float) -> Iterator[Grid]:
    """A grid for every two rows of the defender's polygon."""
    # As far from both polygons' edges as rounding asks.
    apart = polygon_rows(sep.apart) / (1 + APART)
    together = polygon_rows(sep.together_at(alpha)) / (1 - TOGETHER)
    for i, j in combinations(range(len(apart)), 2):
        edges = np.array(np.linalg.inv(apart[[i, j]]).T, dtype=float)
        yield Grid(edges, tuple(_columns(*np.abs(edges @ together.T))))


def _columns(first: Array, second: Array) -> Iterator[int]:
    """Entries of :class:`Grid`'s ``columns``; both edges' sizes along each row are given.

    Of a e_1 + b e_2 and a e_1 - b e_2 one has both parts of one sign along a row.
    """
    a, moves = 0, second > 0
    while (a * first <= 1).all():
        yield 1 + math.floor(float(((1 - a * first)[moves] / second[moves]).min()))
        a += 1


def plane_size(sep: Separation, alpha: float) -> int:
    """The most points of a grid that are apart and together."""
    if not sep.room(alpha) > 0:
        return 1
    return max(a * b for grid in grids(sep, alpha) for a, b in enumerate(grid.columns, start=1))


def plane_offsets(sep: Separation, alpha: float, size: int) -> Array:
    """``size`` points of a grid, the closest to each other, shape (size, 2).

    Centred by their bounding box, so that a box U stays a box.
    """
    best, least = np.zeros((size, 2)), math.inf
    for grid in grids(sep, alpha):
        for a, most in enumerate(grid.columns[:size], start=1):
            b = math.ceil(size / a)
            if b > most:
                continue
            points = grid.points(a, b)
            middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
            for centre in np.vstack([points, middle[None]]):
                near = np.argsort(((points - centre) ** 2).sum(axis=1), kind="stable")[:size]
                chosen = points[np.sort(near)]
                spread = float(chosen.var(axis=0).sum())
                if spread < least * (1 - 1e-9):
                    best, least = chosen, spread
    centred: Array = best - 0.5 * (best.min(axis=0) + best.max(axis=0))
    return centred
