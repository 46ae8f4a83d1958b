"""Convex polytopes { v : H v <= h } with the origin inside: planar ones exactly, others by Qhull.

In the plane everything is done on half-planes sorted by the angle of their unit normals, without
vertices: after two hundred steps of the recursion the normals of neighbouring edges are 1e-7 rad
apart, where vertices are good to nine digits only. Differences of neighbouring rows are exact in
floating point (Sterbenz), so the redundancy test is written in differences.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike

from protocol.arrays import Array, Indices

if TYPE_CHECKING:
    from scipy.spatial import ConvexHull


UNEVEN: Final = 1024.0
"""A set of three or four dimensions whose widths differ by more gets its corners in other units."""


class SetError(Exception):
    """A set that is empty, unbounded or without the origin in its interior."""


@dataclass(frozen=True, eq=False)
class Polytope:
    """The set { v : H v <= h }.

    Parameters
    ----------
    H : array, shape (r, n)
        Outward normals, of unit length where the set comes from this module.
    h : array, shape (r,)
        Support of the set in each normal's direction, positive.
    """

    H: Array
    h: Array

    @classmethod
    def from_rows(cls, H: ArrayLike, h: ArrayLike) -> "Polytope":
        """Normalise the rows; a zero row that holds for every v is dropped.

        Raises
        ------
        SetError
            When the origin is not in the interior.
        """
        rows, bounds = np.array(H, dtype=float), np.array(h, dtype=float)
        lengths = np.sqrt((rows * rows).sum(axis=1))
        if not (bounds > 0).all():
            raise SetError("the origin is not in the interior")
        keep = lengths > 1e-14 * max(1.0, float(lengths.max(initial=0.0)))
        rows, bounds, lengths = rows[keep], bounds[keep], lengths[keep]
        return cls(rows / lengths[:, None], bounds / lengths)

    @property
    def dimension(self) -> int:
        """Number of components of the set's vectors."""
        return int(self.H.shape[1])

    @property
    def facets(self) -> int:
        """Number of rows."""
        return len(self.h)

    def scaled(self, factor: float) -> "Polytope":
        """The set ``factor`` times as large."""
        return Polytope(self.H, self.h * factor)

    def in_units(self, units: Array | None) -> "Polytope":
        """The set { w : units * w in this set }; the set itself where no units are given."""
        if units is None:
            return self
        rows = self.H * units
        lengths = np.sqrt((rows * rows).sum(axis=1))
        return Polytope(rows / lengths[:, None], self.h / lengths)

    def excess(self, v: ArrayLike) -> float:
        """How far ``v`` is outside, in the unit of ``h``; zero or less inside."""
        return float((self.H @ np.asarray(v, dtype=float) - self.h).max())


def cross(a: Array, b: Array) -> Array:
    """a_1 b_2 - a_2 b_1 over the last axis, by the difference b - a: accurate when b is near a."""
    d = b - a
    out: Array = a[..., 0] * d[..., 1] - a[..., 1] * d[..., 0]
    return out


def planar_rows(H: Array, h: Array) -> Array:
    """Rows as columns (a_1, a_2, h) sorted by the angle of their unit normals, shape (3, r)."""
    rows = np.concatenate([H.T, h[None]])
    out: Array = rows[:, np.arctan2(rows[1], rows[0]).argsort(kind="stable")]
    return out


@dataclass(frozen=True, eq=False)
class Ring:
    """What neighbouring rows of sets with the same normals say of each other.

    Parameters
    ----------
    rows : array, shape (2 + k, r + 2)
        Normals in order of angle and the bounds of k sets, the last row first and the first last.
    steps : array, shape (2 + k, r + 1)
        Differences of neighbours.
    turns : array, shape (r + 1,)
        Sine of the angle between neighbours.
    slack : array, shape (k, r)
        Length of each row's edge times its two turns; with its neighbours less than half a turn
        apart a row is redundant when this is not positive.
    """

    rows: Array
    steps: Array
    turns: Array
    slack: Array

    @classmethod
    def of(cls, rows: Array) -> "Ring":
        """Of columns (a_1, a_2, h, ...) in order of angle, shape (2 + k, r)."""
        around = np.concatenate([rows[:, -1:], rows, rows[:, :1]], axis=1)
        steps = around[:, 1:] - around[:, :-1]
        turns = around[0, :-1] * steps[1] - around[1, :-1] * steps[0]
        bend = steps[0, :-1] * steps[1, 1:] - steps[1, :-1] * steps[0, 1:]
        slack = turns[:-1] * steps[2:, 1:] - turns[1:] * steps[2:, :-1] + rows[2:] * bend
        return cls(around, steps, turns, slack)

    @property
    def irredundant(self) -> bool:
        """Whether every set is bounded and every row has an edge in every set."""
        return bool(self.turns.min() > 0 and self.slack.min() > 0)


def planar_irredundant(rows: Array) -> Array:
    """Drop the redundant columns (a_1, a_2, h) of a set; they are in order of angle.

    A row between its neighbours a and c is redundant when the corner of a and c satisfies it. Rows
    are dropped only while both neighbours stay, so no row is judged by one that is leaving.

    Raises
    ------
    SetError
        When the set is unbounded or without interior.
    """
    if not (rows[2] > 0).all():
        raise SetError("the origin is not in the interior")
    while True:
        if rows.shape[1] < 3:
            raise SetError("the set is unbounded")
        ring = Ring.of(rows)
        if ring.irredundant:
            return rows
        a, b, c = ring.rows[:, :-2].T, rows.T, ring.rows[:, 2:].T
        redundant = (cross(a, c) > 0) & (ring.slack[0] <= 0)
        ab, bc = ring.turns[:-1], ring.turns[1:]
        if not (ring.turns > 0).all():
            # Sorted rows that turn back by a rounding are parallel, as those that do not turn.
            same_a = (ab <= 0) & ((a * b)[:, :2].sum(axis=1) > 0)
            same_c = (bc <= 0) & ((c * b)[:, :2].sum(axis=1) > 0)
            # Of equal rows the first stays, so that one pass thins them all.
            twice = (same_a & (a[:, 2] <= b[:, 2])) | (same_c & (c[:, 2] < b[:, 2]))
            redundant = np.where(same_a | same_c, twice, redundant)
        if not redundant.any():
            if not (ring.turns > 0).all():
                raise SetError("the set is unbounded")
            return rows
        leaving = redundant & ~np.concatenate([redundant[-1:], redundant[:-1]])
        if not leaving.any():
            leaving[0] = True
        rows = rows[:, ~leaving]


def planar_polytope(rows: Array) -> Polytope:
    """The polytope of columns (a_1, a_2, h)."""
    return Polytope(np.ascontiguousarray(rows[:2].T), rows[2])


def planar_reduce(H: Array, h: Array) -> Polytope:
    """Sort unit rows by angle and drop the redundant ones.

    Raises
    ------
    SetError
        When the set is unbounded or without interior.
    """
    return planar_polytope(planar_irredundant(planar_rows(H, h)))


def planar_support(p: Polytope, directions: Array) -> Array:
    """Support of an angle-sorted planar polytope: the largest d' v in it for each row d."""
    angles = np.arctan2(p.H[:, 1], p.H[:, 0])
    k = np.searchsorted(angles, np.arctan2(directions[:, 1], directions[:, 0]))
    j, k = k - 1, k % p.facets
    a, c = p.H[j], p.H[k]
    out: Array = (cross(directions, c) * p.h[j] + cross(a, directions) * p.h[k]) / cross(a, c)
    return out


def planar_vertices(p: Polytope) -> Array:
    """Corners of an angle-sorted planar polytope; corner j is of rows j and j + 1, shape (r, 2)."""
    return row_crossings(p.H, p.h, np.roll(np.arange(p.facets), -1))


def row_crossings(H: Array, h: Array, following: Indices) -> Array:
    """Where each line H_j v = h_j of the plane meets the line ``following[j]``, shape (r, 2)."""
    G, g = H[following], h[following]
    d = G - H
    # Along row j's edge the corner lies (g - h cos) / sin from the foot of the normal.
    along = (g - h + 0.5 * h * (d * d).sum(axis=1)) / cross(H, G)
    perpendicular = np.stack([-H[:, 1], H[:, 0]], axis=1)
    out: Array = h[:, None] * H + along[:, None] * perpendicular
    return out


def planar_area(p: Polytope) -> float:
    """Area of an angle-sorted planar polytope."""
    v = planar_vertices(p)
    w = np.roll(v, -1, axis=0)
    return float(0.5 * (v[:, 0] * w[:, 1] - v[:, 1] * w[:, 0]).sum())


def corners(H: ArrayLike, h: ArrayLike) -> Array:
    """Corners of a bounded polytope with the origin inside, shape (corners, n), n = 1 to 4.

    Raises
    ------
    SetError
        When the set is unbounded.
    """
    p = Polytope.from_rows(H, h)
    if p.dimension == 1:
        above, below = interval_reduce(p).h.tolist()
        return np.array([[-below], [above]])
    if p.dimension == 2:
        return planar_vertices(planar_reduce(p.H, p.h))
    units = _units_of(p)
    V = spatial_reduce(p.in_units(units))[1]
    return V if units is None else V * units


def _units_of(p: Polytope) -> Array | None:
    """Units in which a set is about as wide along each coordinate; None where its own will do.

    Qhull's tolerances are those of the largest coordinate.
    """
    narrow = np.abs(p.H / p.h[:, None]).max(axis=0)
    if not narrow.min() > 0 or narrow.max() <= UNEVEN * narrow.min():
        return None
    out: Array = 2.0 ** -np.round(np.log2(narrow))
    return out


def interval_reduce(p: Polytope) -> Polytope:
    """The two rows x <= h_1, -x <= h_2 of a set of one dimension.

    Raises
    ------
    SetError
        When the set is unbounded or without the origin in its interior.
    """
    above, below = p.h[p.H[:, 0] > 0], p.h[p.H[:, 0] < 0]
    if not len(above) or not len(below):
        raise SetError("the set is unbounded")
    if not (p.h > 0).all():
        raise SetError("the origin is not in the interior")
    return Polytope(np.array([[1.0], [-1.0]]), np.array([above.min(), below.min()]))


def spatial_reduce(p: Polytope) -> tuple[Polytope, Array]:
    """Irredundant rows and the corners of a polytope in three or four dimensions.

    By Qhull on the dual: rows become the points H_j / h_j, corners their hull's facets.

    Raises
    ------
    SetError
        When the set is unbounded or without the origin in its interior.
    """
    hull = _dual_hull(p)
    keep = np.sort(hull.vertices)
    return Polytope(p.H[keep], p.h[keep]), hull.equations[:, :-1] / -hull.equations[:, -1:]


def _dual_hull(p: Polytope) -> "ConvexHull":
    from scipy.spatial import ConvexHull, QhullError

    if not (p.h > 0).all():
        raise SetError("the origin is not in the interior")
    points = p.H / p.h[:, None]
    try:
        hull = ConvexHull(points)
    except QhullError:
        try:  # joggled by about 1e-13: the rows kept are the given ones all the same
            hull = ConvexHull(points, qhull_options="QJ Pp")
        except QhullError:
            raise SetError("the set is unbounded or degenerate") from None
    if not (hull.equations[:, -1] < 0).all():
        raise SetError("the set is unbounded")
    return hull


def spatial_faces(p: Polytope) -> tuple[Polytope, Indices, Array]:
    """Irredundant rows, for each corner of the set n of the rows that meet in it, and the corners.

    Raises
    ------
    SetError
        When the set is unbounded or without the origin in its interior.
    """
    hull = _dual_hull(p)
    keep = np.sort(hull.vertices)
    V = hull.equations[:, :-1] / -hull.equations[:, -1:]
    return Polytope(p.H[keep], p.h[keep]), np.searchsorted(keep, hull.simplices), V


def spatial_add_segments(
    p: Polytope, faces: Indices, segments: Iterable[tuple[Array, float, float]]
) -> Polytope:
    """The Minkowski sum of a polytope and segments from ``low * b`` to ``high * b``, not reduced.

    Every facet moves by the segment's support; between neighbours a and c on either side of the
    direction b a new facet appears, the positive combination of both across b. Qhull says which
    facets are neighbours and gives no number: rounding stays at the last digits.

    Parameters
    ----------
    p, faces : Polytope and array, shape (corners, n)
        As :func:`spatial_faces` gives them.
    segments : iterable of (b, low, high)

    Raises
    ------
    SetError
        When a sum is unbounded or without the origin in its interior.
    """
    for number, (b, low, high) in enumerate(segments):
        if number:
            p, faces, _ = spatial_faces(p)
        n = p.dimension
        pairs = np.vstack([faces[:, [i, j]] for i in range(n) for j in range(i + 1, n)])
        g = p.H @ b
        tiny = 1e-12 * float(np.sqrt((b * b).sum()))
        pairs = np.vstack([pairs, pairs[:, ::-1]])
        pairs = np.unique(pairs[(g[pairs[:, 0]] > tiny) & (g[pairs[:, 1]] < -tiny)], axis=0)
        a, c = pairs.T
        H = p.H[a] * -g[c, None] + p.H[c] * g[a, None]
        h = p.h[a] * -g[c] + p.h[c] * g[a]
        lengths = np.sqrt((H * H).sum(axis=1))
        new = lengths > 1e-9 * (g[a] - g[c])
        moved = p.h + np.maximum(low * g, high * g)
        p = Polytope(
            np.vstack([p.H, H[new] / lengths[new, None]]),
            np.concatenate([moved, h[new] / lengths[new]]),
        )
    return p


def spatial_add_polygon(p: Polytope, V: Array) -> Polytope:
    """The Minkowski sum of a polytope and the hull of the points V, shape (points, n).

    Qhull finds the normals of the sum; the offsets are the sum of both supports, so that a
    normal's rounding makes the set larger, never smaller, by as little.

    Raises
    ------
    SetError
        When the set is unbounded or without the origin in its interior.
    """
    from scipy.spatial import ConvexHull

    W = spatial_reduce(p)[1]
    normals = ConvexHull((W[:, None] + V).reshape(-1, p.dimension)).equations[:, :-1]
    # A facet of many corners comes in simplices, each with the normal to the last digits.
    _, first = np.unique(np.round(normals, 12), axis=0, return_index=True)
    H = normals[first]
    return spatial_reduce(Polytope(H, (W @ H.T).max(axis=0) + (V @ H.T).max(axis=0)))[0]
