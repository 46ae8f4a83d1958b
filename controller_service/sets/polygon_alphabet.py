"""Alphabets of two inputs: points of the plane, more than 1 and at most t apart in polygonal norms.

Where both norms have the same parallelogram as their ball, as with boxes of which two rows decide,
a grid along its edges is exact. Otherwise the most points of a densest lattice are sought by exact
clique search, and again on the lattice refined; Brunn's and Oler's inequalities say what no
alphabet exceeds.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from controller_service.sets.clique import adjacency, largest_clique
from controller_service.sets.separation import APART, TOGETHER, AlphabetError, Separation
from protocol.arrays import Array
from protocol.convex import Polytope, SetError, planar_area, planar_reduce, planar_vertices

BRANCHES = 200_000
"""Branches of one clique search, some seconds."""

NODES = 900
"""Points of a refined lattice that a clique search may have."""


@dataclass(frozen=True, eq=False)
class Ball:
    """The polygon { v : abs(row v) <= 1 for each row }.

    Parameters
    ----------
    rows : array, shape (r, 2)
        Irredundant, one of each pair of opposite edges.
    """

    rows: Array

    @classmethod
    def of(cls, rows: Array) -> "Ball":
        """Drop the redundant rows.

        Raises
        ------
        SetError
            When the ball is unbounded: the inputs do not act independently.
        """
        both = np.vstack([rows, -rows])
        lengths = np.sqrt((both * both).sum(axis=1))
        keep = lengths > 1e-12 * lengths.max()
        p = planar_reduce(both[keep] / lengths[keep, None], 1 / lengths[keep])
        scaled = p.H / p.h[:, None]
        return cls(scaled[: len(scaled) // 2])

    def norm(self, v: Array) -> Array:
        """The norm of each vector, shape (..., 2)."""
        out: Array = np.abs(v @ self.rows.T).max(axis=-1)
        return out

    def _polygon(self) -> Polytope:
        both = np.vstack([self.rows, -self.rows])
        lengths = np.sqrt((both * both).sum(axis=1))
        return planar_reduce(both / lengths[:, None], 1 / lengths)

    def corners(self) -> Array:
        """Corners in order of angle, shape (2 r, 2)."""
        return planar_vertices(self._polygon())

    @property
    def area(self) -> float:
        """Area of the ball."""
        return planar_area(self._polygon())

    @property
    def perimeter(self) -> float:
        """Length of the boundary in the ball's own norm, 6 to 8."""
        V = self.corners()
        return float(self.norm(np.roll(V, -1, axis=0) - V).sum())

    @property
    def parallelogram(self) -> bool:
        """Whether the ball has four corners."""
        return len(self.rows) == 2


def balls(sep: Separation, alpha: float) -> tuple[Ball, Ball]:
    """Differences that the defender may mistake, and those that she cannot tell from 0."""
    return Ball.of(sep.apart), Ball.of(sep.together_at(alpha))


def grid_counts(apart: Ball, together: Ball) -> tuple[float, float] | None:
    """Extent over spacing along both edges of one parallelogram; None for any other pair."""
    if not (apart.parallelogram and together.parallelogram):
        return None
    out = []
    for row in apart.rows:
        unit = row / np.hypot(*row)
        same = [
            r for r in together.rows if abs(unit[0] * r[1] - unit[1] * r[0]) <= 1e-12 * np.hypot(*r)
        ]
        if len(same) != 1:
            return None
        out.append(float(np.hypot(*row) / np.hypot(*same[0])))
    return out[0], out[1]


def plane_points(sep: Separation, alpha: float) -> Array:
    """The largest alphabet found, uncentred, shape (M, 2)."""
    if not sep.room(alpha) > 0:
        return np.zeros((1, 2))
    apart, together = _clear(*_balls(sep, alpha))
    counts = grid_counts(apart, together)
    if counts is not None:
        sides = [1 + math.floor(c) for c in counts]
        i, j = np.meshgrid(*(np.arange(s, dtype=float) for s in sides), indexing="ij")
        return np.array(np.stack([i.ravel(), j.ravel()], axis=1) @ edges(apart), dtype=float)
    key = tuple(np.concatenate([apart.rows.ravel(), together.rows.ravel()]).tolist())
    return _searched(key, len(apart.rows))


def _balls(sep: Separation, alpha: float) -> tuple[Ball, Ball]:
    try:
        return balls(sep, alpha)
    except SetError:
        raise AlphabetError(
            "plant.B: the inputs move the state along one line, expected two independent ones"
        ) from None


def _clear(apart: Ball, together: Ball) -> tuple[Ball, Ball]:
    """Both balls as far from their edges as rounding asks."""
    return Ball(apart.rows / (1 + APART)), Ball(together.rows / (1 - TOGETHER))


def edges(apart: Ball) -> Array:
    """Rows e_1, e_2 with norm 1 along a parallelogram's edges: row i of the ball is 1 on e_i."""
    return np.array(np.linalg.inv(apart.rows).T, dtype=float)


@lru_cache(maxsize=64)
def _searched(key: tuple[float, ...], r: int) -> Array:
    rows = np.array(key).reshape(-1, 2)
    apart, together = Ball(rows[:r]), Ball(rows[r:])
    lattice = densest_lattice(apart)
    best = np.zeros((1, 2))
    for refine in (1, 2, 4):
        found = clique_points(apart, together, lattice / refine, at_least=len(best))
        if len(found) > len(best):
            best = found
    return best


def densest_lattice(apart: Ball) -> Array:
    """Basis p, q (rows) of a densest lattice whose points are 1 apart.

    One with p, q and q - p on the ball's boundary (Minkowski). For each p on the boundary q is one
    root: along the boundary from p to -p the norm of q - p grows.
    """
    V = apart.corners()
    along = np.linspace(0, 1, 720, endpoint=False)[:, None, None]
    W = np.roll(V, -1, axis=0)
    p = (V + along * (W - V)).reshape(-1, 2)
    best = _second(apart, p)
    p, q = min(
        zip(p, best, strict=True),
        key=lambda pair: abs(pair[0][0] * pair[1][1] - pair[0][1] * pair[1][0]),
    )
    return np.array([p, q])


def _second(apart: Ball, p: Array) -> Array:
    """For each p on the boundary, q on it and 1 from p, counter-clockwise."""
    angle = np.arctan2(p[:, 1], p[:, 0])
    low, high = angle, angle + np.pi

    def at(a: Array) -> Array:
        d = np.stack([np.cos(a), np.sin(a)], axis=1)
        out: Array = d / apart.norm(d)[:, None]
        return out

    for _ in range(60):
        middle = 0.5 * (low + high)
        near = apart.norm(at(middle) - p) < 1
        low, high = np.where(near, middle, low), np.where(near, high, middle)
    return at(high)


def clique_points(apart: Ball, together: Ball, basis: Array, *, at_least: int = 0) -> Array:
    """The most points of a lattice that are 1 apart and together, found by clique search.

    The first of them in lexicographic order is taken as the origin, so only points after it within
    reach are vertices. Empty when none is larger than ``at_least``.
    """
    reach = together.corners()
    most = np.abs(reach @ np.linalg.inv(basis)).max(axis=0)
    counts = np.floor(most + 1e-9).astype(int)
    i, j = np.meshgrid(*(np.arange(-c, c + 1) for c in counts), indexing="ij")
    steps = np.stack([i.ravel(), j.ravel()], axis=1)
    after = (steps[:, 0] > 0) | ((steps[:, 0] == 0) & (steps[:, 1] > 0))
    points = steps[after] @ basis
    fits = (apart.norm(points) >= 1 - 1e-12) & (together.norm(points) <= 1)
    points = points[fits]
    if len(points) > NODES:
        return np.zeros((0, 2))
    d = points[:, None] - points[None]
    joined = (apart.norm(d) >= 1 - 1e-12) & (together.norm(d) <= 1)
    np.fill_diagonal(joined, val=False)
    clique = largest_clique(adjacency(joined), at_least=at_least - 1, most_branches=BRANCHES)
    if len(clique.vertices) + 1 <= at_least:
        return np.zeros((0, 2))
    return np.vstack([np.zeros((1, 2)), points[list(clique.vertices)]])


def plane_bound(sep: Separation, alpha: float) -> int:
    """No alphabet of two inputs is larger: Brunn's inequality, or Oler's where it says less."""
    if not sep.room(alpha) > 0:
        return 1
    apart, together = _balls(sep, alpha)
    counts = grid_counts(apart, together)
    if counts is not None:
        return max(1, math.ceil(counts[0])) * max(1, math.ceil(counts[1]))
    # Points p have disjoint p + S/2 within a set X with X - X in W + S, and 4 vol X <= vol(X - X).
    both = (apart.corners()[:, None] + together.corners()[None]).reshape(-1, 2)
    from scipy.spatial import ConvexHull

    brunn = float(ConvexHull(both).volume) / apart.area
    t = float(apart.norm(together.corners()).max())
    if t <= 1:
        return 1
    p, q = densest_lattice(apart)
    # The scan finds the smallest determinant to a millionth.
    least = abs(p[0] * q[1] - p[1] * q[0]) * (1 - 1e-5)
    oler = t * t * apart.area / (4 * least) + t * apart.perimeter / 4 + 1
    return math.floor(float(min(brunn, oler)) + 1e-9)


def plane_offsets(sep: Separation, alpha: float, size: int) -> Array:
    """``size`` offsets of the largest alphabet found, the closest to each other, shape (size, 2).

    Centred by their bounding box, so that a box U stays a box.
    """
    apart, together = _clear(*_balls(sep, alpha))
    counts = grid_counts(apart, together)
    choices: list[Array] = []
    if counts is not None:
        sides = [1 + math.floor(c) for c in counts]
        for a in range(1, min(sides[0], size) + 1):
            b = min(math.ceil(size / a), sides[1])
            if a * b >= size:
                i, j = np.meshgrid(np.arange(a), np.arange(b), indexing="ij")
                choices.append(np.stack([i.ravel(), j.ravel()], axis=1) @ edges(apart))
    else:
        choices.append(plane_points(sep, alpha))
    best, least = np.zeros((size, 2)), math.inf
    for points in choices:
        for centre in np.vstack([points, 0.5 * (points.min(axis=0) + points.max(axis=0))[None]]):
            near = np.argsort(((points - centre) ** 2).sum(axis=1), kind="stable")[:size]
            chosen = points[np.sort(near)]
            spread = float(chosen.var(axis=0).sum())
            if len(chosen) == size and spread < least * (1 - 1e-9):
                best, least = chosen, spread
    centred: Array = best - 0.5 * (best.min(axis=0) + best.max(axis=0))
    return centred
