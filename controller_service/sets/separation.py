"""When two inputs are apart for the defender and together for the eavesdropper, as two norms."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from controller_service.sets.spacing import CERTAIN
from controller_service.sets.terminal import set_corners
from protocol.arrays import Array
from protocol.scenario import ConvexSet

APART = 1e-6
"""Candidates are this fraction farther apart than they must be: the verdict counts a gauge up to
1 + 1e-9 as inside, and the plant's sum rounds."""

TOGETHER = 1e-9
"""Candidates are this fraction closer together than alpha allows: alpha is compared sharply."""


class AlphabetError(ValueError):
    """An alphabet that does not fit; the message is one line that names the field."""


@dataclass(frozen=True, eq=False)
class Separation:
    """Two norms of a difference of inputs v, of which both are the largest ``abs(row v)``.

    Parameters
    ----------
    apart : array, shape (r, m)
        Rows of the gauge of D_c - D_c at B v: above 1 the defender tells the candidates apart.
    together : array, shape (r', m)
        Rows of the gauge of D_c and -D_c at B v: up to alpha - 1 the eavesdropper does not.
    """

    apart: Array
    together: Array

    @classmethod
    def of(cls, B: ArrayLike, disturbance: ConvexSet) -> "Separation":
        """For the inputs of B, shape (n, m), and D_c."""
        matrix = np.asarray(B, dtype=float)
        rows, bounds = disturbance.rows()
        H = np.array(rows) / np.array(bounds)[:, None]
        if _symmetric(H):
            return cls(_distinct(H @ matrix / 2), _distinct(H @ matrix))
        return cls(_distinct(_difference_rows(set_corners(disturbance)) @ matrix), H @ matrix)

    @property
    def inputs(self) -> int:
        """m."""
        return int(self.apart.shape[1])

    def spaced(self, spacing: float) -> "Separation":
        """With candidates ``spacing`` half-lengths apart instead of 2."""
        return Separation(self.apart * (CERTAIN / spacing), self.together)

    def sigma(self) -> float:
        """One input: the largest difference that the defender may mistake, infinite where b = 0."""
        return _reciprocal(float(np.abs(self.apart).max()))

    def omega(self, alpha: float) -> float:
        """One input: the largest difference of two candidates that are both possible for her."""
        return (alpha - 1) * _reciprocal(float(np.abs(self.together).max()))


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
