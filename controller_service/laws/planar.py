"""Planar plants with one input: set index and both programs by look-up, one state or many.

One state and many states take the same look-ups and the same elementwise arithmetic in the same
order, so their results agree to the last bit. No BLAS, no fused multiply and add, no arctangent.

Membership in T_i asks one facet only: the one in whose sector, seen from the origin, x lies. The
sectors of all sets lie in one sorted list, set i in the range 4 i to 4 i + 4, and are searched
by the pseudo-angle of x. The programs' inputs form an interval. Along the line A x + B u one facet
of the target bounds u from above and one from below; they depend on the line's offset alone, and
are found in two more sorted lists.
"""

from collections.abc import Sequence

import numpy as np

from controller_service.laws.online import Lookup, Table
from controller_service.laws.programs import Quadratic
from controller_service.sets.design import Design
from controller_service.tolerances import CHAIN_PARALLEL
from protocol.arrays import Array, Indices
from protocol.convex import Polytope, planar_vertices
from protocol.scenario import Cost


def pseudo_angle(x1: Array, x2: Array) -> Array:
    """A number in [0, 4] that grows with the angle of (x1, x2); see the scalar twin in Planar."""
    r = np.abs(x1) + np.abs(x2)
    r = np.where(r > 0.0, r, 1.0)
    q = x2 / r
    p: Array = np.where(x1 < 0.0, 2.0 - q, np.where(x2 < 0.0, 4.0 + q, q))
    return p


class Sectors:
    """The facets of T_0..T_N by sector.

    ``keys`` holds 4 i + the pseudo-angle of each corner of T_i; a set with r facets has r corners
    and r + 1 entries in ``a1``, ``a2``, ``b``, the first of them repeated across the angle zero.
    """

    def __init__(self, family: Sequence[tuple[Array, Array]]) -> None:
        keys, rows = [], []
        for i, (H, h) in enumerate(family):
            corner = planar_vertices(Polytope(H, h))
            angle = pseudo_angle(corner[:, 0], corner[:, 1])
            start = int(angle.argmin())
            keys.append(4.0 * i + np.maximum.accumulate(np.roll(angle, -start)))
            # Corner j is of rows j and j + 1: the sector before corner `start` is row `start`'s.
            ring = np.roll(np.column_stack([H, h]), -start, axis=0)
            rows.append(np.vstack([ring, ring[:1]]))
        self.first, self.last = len(keys[0]), len(rows[-1])  # corners of T_0, rows of T_N
        self.keys = np.concatenate(keys)
        table = np.vstack(rows)
        self.a1, self.a2, self.b = (np.ascontiguousarray(table[:, j]) for j in range(3))


class Chain:
    """The facets of the targets that bound u on one side, by the offset of the line A x + B u.

    The offset is scaled to [-1, 1] in each target; ``keys`` holds 4 j + the scaled offset of each
    corner between two facets of target j. A bound is ``q - (c1 x_1 + c2 x_2)``.
    """

    def __init__(self, design: Design, side: float, scale: Sequence[float], shrink: Array) -> None:
        B = design.B[:, 0]
        across = np.array([-B[1], B[0]])
        keys, rows = [], []
        for j, (H, h) in enumerate(design.targets):
            g = H @ B
            bounding = side * g > CHAIN_PARALLEL * float(np.abs(B).sum())
            offset = planar_vertices(Polytope(H, h)) @ across * (shrink[j] * scale[j])
            # Facets are sorted by angle, so a chain is one run of them, circular.
            first = int(np.flatnonzero(bounding & ~np.roll(bounding, 1))[0])
            run = (first + np.arange(int(bounding.sum()))) % len(h)
            order, between = run, offset[run[:-1]]
            if side < 0:
                # Counter-clockwise the offset falls along the lower chain.
                order, between = order[::-1], between[::-1]
            keys.append(4.0 * j + np.maximum.accumulate(between))
            G = g[order]
            rows.append(
                np.column_stack([h[order] * shrink[j] / G, (H[order] @ design.A) / G[:, None]])
            )
        self.first = len(keys[0])  # keys of target 0
        self.keys = np.concatenate(keys)
        table = np.vstack(rows)
        self.q, self.c1, self.c2 = (np.ascontiguousarray(table[:, i]) for i in range(3))


def _table(*columns: Array) -> Table:
    return Table(*(np.ascontiguousarray(column).data.cast("B").cast("d") for column in columns))


class Planar(Lookup):
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
        self.sectors = Sectors(design.T)
        B = design.B[:, 0]
        across = np.array([-B[1], B[0]])
        widths = [
            float(np.abs(planar_vertices(Polytope(H, h)) @ across).max()) for H, h in design.targets
        ]
        scale = [1 / (w * k) for w, k in zip(widths, shrink.tolist(), strict=True)]
        self.upper = Chain(design, 1.0, scale, shrink)
        self.lower = Chain(design, -1.0, scale, shrink)
        line = across @ design.A
        # Offset of target j's line, already scaled: line1[j] x_1 + line2[j] x_2 + 4 j.
        self.line1 = line[0] * np.array(scale)
        self.line2 = line[1] * np.array(scale)
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
