"""When two inputs are apart for the defender and together for the eavesdropper, as two norms."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from controller_service.sets.terminal import set_corners
from protocol.arrays import Array
from protocol.scenario import ConvexSet
from protocol.scenario.laws import CERTAIN

APART = 1e-6
"""Candidates are this fraction farther apart than they must be: the verdict counts a gauge up to
1 + 1e-9 as inside, and the plant's sum rounds."""

TINY = 1e-12
"""Room, in gauges, below which Eve has none along a row."""

TOGETHER = 1e-9
"""Candidates are this fraction closer together than alpha allows: alpha is compared sharply."""


class AlphabetError(ValueError):
    """An alphabet that does not fit; the message is one line that names the field."""


@dataclass(frozen=True, eq=False)
class Separation:
    """Two norms of a difference of inputs v: the largest ``abs(row v)``, of the second over a room.

    Parameters
    ----------
    apart : array, shape (r, m)
        Rows of the gauge of D_c - D_c at B v: above 1 the defender tells the candidates apart.
    together : array, shape (r', m)
        Rows of the gauge of D_e over alpha and its mirror image at B v: up to alpha - ``taken`` the
        eavesdropper does not.
    taken : array, shape (r',)
        How far D_c reaches along each of these rows: 1 where D_e = alpha D_c.
    """

    apart: Array
    together: Array
    taken: Array

    @classmethod
    def of(
        cls,
        B: ArrayLike,
        disturbance: ConvexSet,
        shape: ConvexSet | None = None,
        tested: ConvexSet | None = None,
    ) -> "Separation":
        """For the inputs of B, shape (n, m), D_c, and D_e over alpha where it is not D_c.

        ``tested`` is W, where the defender's half of the test is not D_c.
        """
        if tested is not None:
            hers = cls.of(B, disturbance, shape)
            return cls(cls.of(B, tested).apart, hers.together, hers.taken)
        matrix = np.asarray(B, dtype=float)
        rows, bounds = disturbance.rows()
        H = np.array(rows) / np.array(bounds)[:, None]
        if shape is not None:
            own = cls.of(B, disturbance)
            hers_rows, hers_bounds = shape.rows()
            scaled = np.array(hers_rows) / np.array(hers_bounds)[:, None]
            taken = (set_corners(disturbance) @ scaled.T).max(axis=0)
            return cls(own.apart, scaled @ matrix, np.asarray(taken, dtype=float))
        if _symmetric(H):
            together = _distinct(H @ matrix)
            return cls(_distinct(H @ matrix / 2), together, np.ones(len(together)))
        apart = _distinct(_difference_rows(set_corners(disturbance)) @ matrix)
        return cls(apart, H @ matrix, np.ones(len(H)))

    @property
    def inputs(self) -> int:
        """m."""
        return int(self.apart.shape[1])

    def spaced(self, spacing: float) -> "Separation":
        """With candidates ``spacing`` half-lengths apart instead of 2."""
        return Separation(self.apart * (CERTAIN / spacing), self.together, self.taken)

    def room(self, alpha: float) -> float:
        """The smallest of alpha less what D_c takes: above 0 where D_c is well inside D_e."""
        return float((alpha - self.taken).min())

    def together_at(self, alpha: float) -> Array:
        """Rows of the norm up to 1 of which both candidates are possible for Eve, for every d."""
        out: Array = self.together / np.maximum(alpha - self.taken, TINY)[:, None]
        return out

    def sigma(self) -> float:
        """One input: the largest difference that the defender may mistake, infinite where b = 0."""
        return _reciprocal(float(np.abs(self.apart).max()))

    def omega(self, alpha: float) -> float:
        """One input: the largest difference of two candidates that are both possible for Eve."""
        moved = np.abs(self.together).max(axis=1)
        if not moved.any():
            return math.inf
        room = np.maximum(0.0, alpha - self.taken)
        return float((room[moved > 0] / moved[moved > 0]).min())


def _reciprocal(value: float) -> float:
    return 1 / value if value > 0 else math.inf


def _symmetric(H: Array) -> bool:
    """Whether every row's opposite is a row."""
    return all((np.abs(H + row).max(axis=1) == 0).any() for row in H)


def _distinct(rows: Array) -> Array:
    """Rows, one of each pair of opposites, without the zero rows."""
    kept: list[Array] = []
    for row in rows:
        if row.any() and not any((row == other).all() or (row == -other).all() for other in kept):
            kept.append(row)
    return np.array(kept) if kept else np.zeros((1, rows.shape[1]))


def _difference_rows(V: Array) -> Array:
    """Rows r with abs(r y) <= 1 for y in V - V, the differences of a polytope's corners."""
    if V.shape[1] == 1:
        return np.array([[1 / float(np.ptp(V))]])
    from scipy.spatial import ConvexHull

    hull = ConvexHull((V[:, None] - V[None]).reshape(-1, V.shape[1]))
    out: Array = hull.equations[:, :-1] / -hull.equations[:, -1:]
    return out
