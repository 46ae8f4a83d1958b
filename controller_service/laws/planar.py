"""Planar plants with one input: set index and both programs by look-up, one state or many.

One state and many states take the same look-ups and the same elementwise arithmetic in the same
order, so their results agree to the last bit. No BLAS, no fused multiply and add, no arctangent.

Membership in T_i asks one facet only: the one in whose sector, seen from the origin, x lies. The
sectors of all sets lie in one sorted list, set i in the range 4 i to 4 i + 4, and are searched
by the pseudo-angle of x. The programs' inputs form an interval. Along the line A x + B u one facet
of the target bounds u from above and one from below; they depend on the line's offset alone, and
are found in two more sorted lists.
"""

from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controller_service.laws.programs import Quadratic
from controller_service.sets.design import Design
from controller_service.tolerances import CHAIN_PARALLEL
from protocol.arrays import Array, Indices
from protocol.convex import row_crossings
from protocol.scenario import Cost


def pseudo_angle(x1: Array, x2: Array) -> Array:
    """A number in [0, 4] that grows with the angle of (x1, x2); see the scalar twin in Planar."""
    r = np.abs(x1) + np.abs(x2)
    r = np.where(r > 0.0, r, 1.0)
    q = x2 / r
    p: Array = np.where(x1 < 0.0, 2.0 - q, np.where(x2 < 0.0, 4.0 + q, q))
    return p


class Rows:
    """The rows of several planar sets, one set after the other.

    Rows without an edge are left out. Where two rows are nearly parallel, rounding moves the corner
    between them along both, by up to 1e-2 of its distance from the origin. It may then lie beyond
    the next corner, and a state between them would be held against a facet on the other side. The
    row between such corners bounds nothing that rounding does not cover.

    Attributes
    ----------
    H, h : array
        All rows H v <= h, each set's in order of angle.
    edges : list of int
        Set i has the rows ``edges[i]`` to ``edges[i + 1]``.
    sizes : array
        Rows of each set.
    corners : array, shape (rows, 2)
        Corner j is of row j and the row that follows it in its set.
    """

    def __init__(self, family: Sequence[tuple[Array, Array]]) -> None:
        self.H = np.concatenate([H for H, _ in family])
        self.h = np.concatenate([h for _, h in family])
        self.sizes = np.array([len(h) for _, h in family])
        while True:
            self.edges = [0, *self.sizes.cumsum().tolist()]
            second = np.ones(len(family), dtype=np.intp)
            self.corners = row_crossings(self.H, self.h, self.from_row(second, 0))
            none = self._without_edge()
            if not none.any():
                return
            self.sizes = np.add.reduceat(~none, self.edges[:-1])
            self.H, self.h = self.H[~none], self.h[~none]

    def _without_edge(self) -> NDArray[np.bool_]:
        """Rows whose two corners are out of order; of neighbours the first."""
        before = self.from_row(self.sizes - 1, 0)
        edge = self.corners - self.corners[before]
        none: NDArray[np.bool_] = self.H[:, 0] * edge[:, 1] - self.H[:, 1] * edge[:, 0] < 0
        return none & ~none[before]

    def from_row(self, start: Indices, more: int) -> Indices:
        """Each set's rows around it from row ``start[i]`` on, the first ``more`` of them twice."""
        sizes = self.sizes + more
        ends = sizes.cumsum()
        place = np.arange(ends[-1]) - np.repeat(ends - sizes, sizes)
        first, around = np.repeat(self.edges[:-1], sizes), np.repeat(self.sizes, sizes)
        out: Indices = first + (place + np.repeat(start, sizes)) % around
        return out

    def of_set(self, numbers: Array) -> Array:
        """One number of each set, for each of its rows."""
        return np.repeat(numbers, self.sizes)


class Sectors:
    """The facets of T_0..T_N by sector.

    ``keys`` holds 4 i + the pseudo-angle of each corner of T_i; a set with r facets has r corners
    and r + 1 entries in ``a1``, ``a2``, ``b``, the first of them repeated across the angle zero.
    """

    def __init__(self, sets: Rows) -> None:
        angle = pseudo_angle(sets.corners[:, 0], sets.corners[:, 1])
        start = np.array([angle[a:b].argmin() for a, b in pairwise(sets.edges)])
        key = (sets.of_set(np.arange(0.0, 4.0 * len(start), 4.0)) + angle)[sets.from_row(start, 0)]
        self.keys = np.maximum.accumulate(key)
        self.first = int(sets.sizes[0])  # keys of T_0
        self.last = int(sets.sizes[-1]) + 1  # rows of T_N
        # Corner j is of rows j and j + 1: the sector before corner `start` is row `start`'s.
        ring = sets.from_row(start, 1)
        self.a1, self.a2, self.b = sets.H[ring, 0], sets.H[ring, 1], sets.h[ring]


class Chain:
    """The facets of the targets that bound u on one side, by the offset of the line A x + B u.

    The offset is scaled to [-1, 1] in each target; ``keys`` holds 4 j + the scaled offset of each
    corner between two facets of target j. A bound is ``q - (c1 x_1 + c2 x_2)``.
    """

    def __init__(
        self, design: Design, side: float, targets: Rows, offset: Array, shrink: Array
    ) -> None:
        B, H = design.B[:, 0], targets.H
        g = H @ B
        bounding = side * g > CHAIN_PARALLEL * float(np.abs(B).sum())
        before = targets.from_row(targets.sizes - 1, 0)
        begins = bounding & ~bounding[before]
        orders, between = [], []
        for a, b in pairwise(targets.edges):
            # Facets are sorted by angle, so a chain is one run of them, circular.
            first = int(begins[a:b].argmax())
            run = a + (first + np.arange(int(bounding[a:b].sum()))) % (b - a)
            # Counter-clockwise the offset falls along the lower chain.
            orders.append(run if side > 0 else run[::-1])
            between.append(run[:-1] if side > 0 else run[-2::-1])
        self.first = len(between[0])  # keys of target 0
        key = targets.of_set(np.arange(0.0, 4.0 * len(orders), 4.0)) + offset
        self.keys = np.maximum.accumulate(key[np.concatenate(between)])
        order = np.concatenate(orders)
        G = g[order]
        self.q = targets.h[order] * targets.of_set(shrink)[order] / G
        self.c1, self.c2 = np.ascontiguousarray((H @ design.A)[order].T) / G


class Table(NamedTuple):
    """Keys and three columns beside them, as arrays whose items are plain floats.

    Lists of floats and tuples took 25 MiB for 250 sets; the arrays' own memory is read instead.
    """

    keys: "memoryview[float]"
    first: "memoryview[float]"
    second: "memoryview[float]"
    third: "memoryview[float]"


def _table(*columns: Array) -> Table:
    return Table(*(np.ascontiguousarray(column).data.cast("B").cast("d") for column in columns))


class Planar:
    """Index and candidates of a planar plant with one input."""

    def __init__(
        self,
        design: Design,
        u_min: float,
        u_max: float,
        costs: Sequence[Cost],
    ) -> None:
        self.N = design.horizon
        self.u_min, self.u_max = u_min, u_max
        shrink = 1 - np.array(design.margins)
        self.sectors = Sectors(Rows(design.T))
        B = design.B[:, 0]
        across = np.array([-B[1], B[0]])
        targets = Rows(design.targets)
        offset = targets.corners @ across
        scale = 1 / (np.maximum.reduceat(np.abs(offset), targets.edges[:-1]) * shrink)
        scaled = offset * targets.of_set(shrink * scale)
        self.upper = Chain(design, 1.0, targets, scaled, shrink)
        self.lower = Chain(design, -1.0, targets, scaled, shrink)
        line = across @ design.A
        # Offset of target j's line, already scaled: line1[j] x_1 + line2[j] x_2 + 4 j.
        self.line1 = line[0] * scale
        self.line2 = line[1] * scale
        self.shift = 4.0 * np.arange(len(scale))
        forms = [Quadratic.of(design.A, design.B, cost) for cost in costs]
        self.gains = [-q.F[0] / q.P[0, 0] for q in forms]
        self._lists()

    def _lists(self) -> None:
        """Tables for the path of one state."""
        s = self.sectors
        self._first, self._last = s.first, s.last
        self._facets = _table(s.keys, s.a1, s.a2, s.b)
        self._upper, self._lower = (
            _table(c.keys, c.q, c.c1, c.c2) for c in (self.upper, self.lower)
        )
        self._lines = list(
            zip(self.line1.tolist(), self.line2.tolist(), self.shift.tolist(), strict=True)
        )
        self._gains = [(float(k[0]), float(k[1])) for k in self.gains]

    def index(self, x: Sequence[float]) -> int:
        """i(k), or N + 1 outside every set: T_0 first, where a closed loop nearly always is."""
        x1, x2 = float(x[0]), float(x[1])
        r = abs(x1) + abs(x2)
        q = x2 / r if r > 0.0 else x2
        p = 2.0 - q if x1 < 0.0 else (4.0 + q if x2 < 0.0 else q)
        keys, a1, a2, b = self._facets
        at = bisect_right(keys, p, 0, self._first)
        if a1[at] * x1 + a2[at] * x2 <= b[at]:
            return 0
        low, high = 1, self.N + 1
        while low < high:
            i = (low + high) >> 1
            at = bisect_right(keys, 4.0 * i + p) + i
            if a1[at] * x1 + a2[at] * x2 <= b[at]:
                high = i
            else:
                low = i + 1
        return low

    def excess(self, x: Sequence[float]) -> float:
        """How far x is outside the largest set, in the unit of its h; zero or less inside."""
        _, a1, a2, b = self._facets
        x1, x2 = float(x[0]), float(x[1])
        return max(a1[at] * x1 + a2[at] * x2 - b[at] for at in range(len(b) - self._last, len(b)))

    def interval(self, x1: float, x2: float, j: int) -> tuple[float, float]:
        """Inputs in U that steer x into the tightened target j; empty when low > high."""
        l1, l2, shift = self._lines[j]
        key = (l1 * x1 + l2 * x2) + shift
        keys, q, c1, c2 = self._upper
        at = bisect_right(keys, key) + j
        high = q[at] - (c1[at] * x1 + c2[at] * x2)
        keys, q, c1, c2 = self._lower
        at = bisect_right(keys, key) + j
        low = q[at] - (c1[at] * x1 + c2[at] * x2)
        return (
            low if low > self.u_min else self.u_min,
            high if high < self.u_max else self.u_max,
        )

    def candidates(self, x: Sequence[float], i: int) -> tuple[tuple[float, ...], ...]:
        """One input for each cost at index i; ValueError when the interval is empty."""
        x1, x2 = float(x[0]), float(x[1])
        low, high = self.interval(x1, x2, i - 1 if i > 0 else 0)
        if not low <= high:
            raise ValueError(f"no input in [{low!r}, {high!r}]")
        out = []
        for k1, k2 in self._gains:
            u = k1 * x1 + k2 * x2
            if u < low:
                u = low
            elif u > high:
                u = high
            out.append((u,))
        return tuple(out)

    def indices(self, X: Array) -> Indices:
        """i(k) of each row, N + 1 outside every set."""
        x1, x2 = np.ascontiguousarray(X[:, 0]), np.ascontiguousarray(X[:, 1])
        p = pseudo_angle(x1, x2)
        s = self.sectors
        at = np.searchsorted(s.keys[: self._first], p, side="right")
        outside = np.flatnonzero(~(s.a1[at] * x1 + s.a2[at] * x2 <= s.b[at]))
        out = np.zeros(len(X), dtype=np.intp)
        if len(outside):
            out[outside] = self._bisect(x1[outside], x2[outside], p[outside])
        return out

    def _bisect(self, x1: Array, x2: Array, p: Array) -> Indices:
        """i(k) of rows outside T_0."""
        s = self.sectors
        low = np.ones(len(p), dtype=np.intp)
        high = np.full(len(p), self.N + 1, dtype=np.intp)
        for _ in range(self.N.bit_length()):
            i = (low + high) >> 1
            open_ = low < high
            j = np.where(open_, i, 0)
            at = np.searchsorted(s.keys, 4.0 * j + p, side="right") + j
            inside = s.a1[at] * x1 + s.a2[at] * x2 <= s.b[at]
            high = np.where(open_ & inside, i, high)
            low = np.where(open_ & ~inside, i + 1, low)
        return low

    def candidates_many(self, X: Array, indices: Indices) -> Array:
        """One input for each row and cost, shape (R, M, 1); ValueError where none is left."""
        x1, x2 = np.ascontiguousarray(X[:, 0]), np.ascontiguousarray(X[:, 1])
        out = np.empty((len(self._gains), len(X)))
        self._clip(x1, x2, indices, out)
        return out.T[:, :, None]

    def _clip(self, x1: Array, x2: Array, indices: Indices, out: Array) -> None:
        """Each cost's own minimiser, clipped to the admissible interval, into a row of ``out``."""
        j = np.maximum(indices - 1, 0)
        inner = not j.any()  # every target is T_0's: its tables alone, which stay in cache
        if inner:
            key = self.line1[0] * x1 + self.line2[0] * x2
        else:
            key = (self.line1[j] * x1 + self.line2[j] * x2) + self.shift[j]
        bounds = []
        for c in (self.upper, self.lower):
            if inner:
                at = np.searchsorted(c.keys[: c.first], key, side="right")
            else:
                at = np.searchsorted(c.keys, key, side="right") + j
            bounds.append(c.q[at] - (c.c1[at] * x1 + c.c2[at] * x2))
        high, low = bounds
        low = np.where(low > self.u_min, low, self.u_min)
        high = np.where(high < self.u_max, high, self.u_max)
        empty = ~(low <= high)
        if empty.any():
            row = int(empty.argmax())
            raise ValueError(
                f"no input in [{low[row]!r}, {high[row]!r}] at x = {[x1[row], x2[row]]}"
            )
        for row, k in zip(out, self._gains, strict=True):
            u = k[0] * x1 + k[1] * x2
            row[:] = np.where(u < low, low, np.where(u > high, high, u))
