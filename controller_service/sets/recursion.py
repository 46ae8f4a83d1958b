"""The recursion T_i = { x : there is u in U with A x + B u in T_(i-1) ~ D_c }, by dimension.

Each step is :meth:`Recursion.erode`, which makes T_i irredundant and erodes it, and
:meth:`Recursion.backward`, which leads from T_(i-1) ~ D_c to the rows of T_i.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator

import numpy as np

from controller_service.sets.terminal import (
    PRODUCTS_AT_ONCE,
    SynthesisError,
    input_interval,
    set_corners,
)
from controller_service.sets.units import in_units, state_units
from controller_service.tolerances import (
    CONDITION,
    GROWTH,
    LARGEST_OFFSET,
    LARGEST_SPREAD,
    LEAST_DEFLATION,
    ROUNDINGS,
    SOLVED_DEFLATION,
)
from protocol.arrays import Array, Indices
from protocol.convex import (
    Polytope,
    Ring,
    SetError,
    corners,
    interval_reduce,
    planar_irredundant,
    planar_polytope,
    planar_rows,
    planar_support,
    spatial_add_polygon,
    spatial_add_segments,
    spatial_faces,
    spatial_reduce,
)
from protocol.scenario import ConvexSet, Scenario

HALF_ULPS = ROUNDINGS * 0.5 * float(np.finfo(float).eps)


def support(V: Array, H: Array) -> Array:
    """Support of the hull of the points V in the directions H; few products at a time."""
    step = max(1, PRODUCTS_AT_ONCE // len(V))
    parts = [(V @ H[i : i + step].T).max(axis=0) for i in range(0, len(H), step)]
    out: Array = parts[0] if len(parts) == 1 else np.concatenate(parts)
    return out


def _ended(i: int, error: SetError) -> str:
    """Where the sets end, why, and what would do."""
    if i == 0:
        return (
            f"defender.disturbance: T_0 has no room for it ({error}); "
            "a smaller one or wider control.inputs would do"
        )
    return (
        f"control.horizon: the sets end at index {i}: {error}; control.horizon = {i - 1} would do, "
        "or a smaller defender.disturbance, or wider control.inputs"
    )


class Recursion(ABC):
    """The steps of one plant.

    Parameters
    ----------
    units : array, shape (n,), or None
        Of the states here, where they are not the plant's; :meth:`enter` and :meth:`leave` convert
        sets. Everything below is in these units.
    least : float
        The smallest fraction by which a set is shrunk.
    DV, BU : array, shapes (corners, n)
        Corners of D_c (of ``control.disturbance`` where given), and -B u at the corners of U.
    X : Polytope or None
        The state bounds.
    spread : float
        Of the set that :meth:`erode` met last: how much larger than a facet's bound the products
        are that it adds up. 0 where every set is shrunk in proportion to it.
    stopped : bool
        Whether the sets ended where rounding would make them too large.
    """

    spread = 0.0
    stopped = False

    def __init__(self, scenario: Scenario) -> None:
        self.A, self.B = np.array(scenario.A), np.array(scenario.B)
        self.least = LEAST_DEFLATION if scenario.n <= 2 and scenario.m == 1 else SOLVED_DEFLATION
        which = "defender" if scenario.control.disturbance is None else "control"
        self.DV = _compact(f"{which}.disturbance", scenario.control_set)
        self.units = state_units(self.A, self.DV)
        if self.units is not None:
            self.A = in_units(self.A, self.units)
            self.B, self.DV = self.B / self.units[:, None], self.DV / self.units
        self.BU = -_compact("control.inputs", scenario.control.inputs) @ self.B.T
        self.X = None
        if scenario.control.states is not None:
            self.X = self.enter(Polytope.from_rows(*scenario.control.states.rows()))

    def enter(self, p: Polytope) -> Polytope:
        """A set in the plant's units, in the units here."""
        return p.in_units(self.units)

    def leave(self, p: Polytope) -> Polytope:
        """A set in the units here, in the plant's."""
        return p if self.units is None else p.in_units(1 / self.units)

    def run(self, T0: Polytope, horizon: int) -> Iterator[tuple[int, Polytope, Polytope, float]]:
        """Yield (i, T_i, T_i ~ D_c, deflation of T_(i+1)) for i = 0..horizon.

        Ends earlier when the sets stop growing, or when rounding would make the next too large.

        Raises
        ------
        SynthesisError
            When a set is empty or unbounded.
        """
        rows, previous = self.enter(T0), None
        for i in range(horizon + 1):
            try:
                if not rows.h.max() < LARGEST_OFFSET:
                    raise SetError(f"it is larger than {LARGEST_OFFSET:g}")
                T, S, deflation = self.erode(rows)
                if previous is not None and _same(previous, T):
                    return
                yield i, self.leave(T), self.leave(S), deflation
                if i == horizon:
                    return
                if self.spread > LARGEST_SPREAD:
                    self.stopped = True
                    return
                rows, previous = self.backward(S, deflation), T
            except SetError as error:
                raise SynthesisError(_ended(i, error)) from None

    @abstractmethod
    def erode(self, T: Polytope) -> tuple[Polytope, Polytope, float]:
        """T and T ~ D_c, irredundant, and the fraction by which the next set is to be shrunk."""

    @abstractmethod
    def backward(self, S: Polytope, deflation: float) -> Polytope:
        """The states that some u in U steers into S, within the state bounds, deflated."""

    def _back_through_plant(self, p: Polytope, deflation: float) -> Polytope:
        """The states within the bounds from which A x lies in p, deflated."""
        back = Polytope.from_rows(p.H @ self.A, p.h)
        if self.X is not None:
            H, h = np.concatenate([back.H, self.X.H]), np.concatenate([back.h, self.X.h])
            back = Polytope(H, h)
        elif back.facets < p.facets:
            raise SetError("A is singular and the set unbounded, expected control.states")
        return back.scaled(1 - deflation)

    def _cancelling(self) -> tuple[Array, Array]:
        """M and c with abs(A) abs(x) + abs(B u) + abs(d) <= M abs(s) + c where A x + B u = s.

        What is added up to the next state may be much larger than the sum, and rounds as such.
        """
        A, push = np.abs(self.A), np.abs(self.BU).max(axis=0)
        rest = push + np.abs(self.DV).max(axis=0)
        M = _condition_matrix(self.A)
        if M is not None:
            return M, M @ push + rest
        if self.X is None:
            raise SynthesisError("control.states: got none, expected a set, for A is singular")
        try:
            largest = np.abs(corners(self.X.H, self.X.h)).max(axis=0)
        except SetError as error:
            raise SynthesisError(
                f"control.states: {error}, expected a compact one, for A is singular"
            ) from None
        return np.eye(len(A)), A @ largest + rest


class IntervalRecursion(Recursion):
    """One state."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario)
        M, c = self._cancelling()
        self.times, self.plus = float(M[0, 0]), float(c[0])

    def erode(self, T: Polytope) -> tuple[Polytope, Polytope, float]:
        """See :meth:`Recursion.erode`."""
        T = interval_reduce(T)
        S = interval_reduce(Polytope(T.H, T.h - support(self.DV, T.H)))
        parts = self.times + self.plus / float(S.h.min())
        return T, S, max(self.least, HALF_ULPS * parts)

    def backward(self, S: Polytope, deflation: float) -> Polytope:
        """See :meth:`Recursion.backward`."""
        grown = Polytope(S.H, S.h + support(self.BU, S.H))
        return self._back_through_plant(grown, deflation)


class PlanarRecursion(Recursion):
    """Two states: rows sorted by angle, no corners.

    The work is on columns (a_1, a_2, h): at these sizes the time is that of NumPy's calls.
    """

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario)
        self.new_normals = self._input_normals()
        self.M, c = self._cancelling()
        self.c = c[:, None]

    def _input_normals(self) -> Array:
        """Unit normals that adding -B U brings in: across each difference of its corners.

        An inner direction of a polygon is no edge's: its row is only found redundant.
        """
        d = (self.BU[:, None, :] - self.BU[None, :, :]).reshape(-1, 2)
        lengths = np.sqrt((d * d).sum(axis=1))
        keep = lengths > 1e-12 * max(1e-300, float(lengths.max()))
        d = d[keep] / lengths[keep, None]
        normals = np.unique(np.round(np.stack([d[:, 1], -d[:, 0]], axis=1), 15), axis=0)
        out: Array = normals / np.sqrt((normals * normals).sum(axis=1))[:, None]
        return out

    def erode(self, T: Polytope) -> tuple[Polytope, Polytope, float]:
        """See :meth:`Recursion.erode`. Both sets have the same normals: one pass judges both."""
        rows = planar_rows(T.H, T.h)
        both = np.concatenate([rows, (rows[2] - support(self.DV, rows[:2].T))[None]])
        ring = Ring.of(both)
        if ring.irredundant and both[3].min() > 0:
            T = planar_polytope(rows)
            S = Polytope(T.H, both[3])
        else:
            rows = planar_irredundant(rows)
            T = planar_polytope(rows)
            h = T.h - support(self.DV, T.H)
            rows = planar_irredundant(np.concatenate([rows[:2], h[None]]))
            S, ring = planar_polytope(rows), Ring.of(rows)
        return T, S, self.deflation(ring)

    def deflation(self, ring: Ring) -> float:
        """Fraction by which the states that reach the ring's last set are shrunk.

        It follows the conditioning: what a facet's product a' s adds up, at a corner s of the set,
        is up to 4e4 times the sum h at index 250, and so is the rounding.
        """
        a, h = np.abs(ring.rows[:2, 1:-1]), ring.rows[-1, 1:-1]
        # From the foot of a row's normal to a corner: (other's h - h cos) / sin of their angle.
        d = ring.steps
        bend = 0.5 * (d[0] * d[0] + d[1] * d[1])
        after = np.abs(d[-1, 1:] + bend[1:] * h) / ring.turns[1:]
        before = np.abs(d[-1, :-1] - bend[:-1] * h) / ring.turns[:-1]
        s = h * a + np.maximum(before, after) * a[::-1]
        parts = (a * (self.M @ s + self.c)).sum(axis=0) / h
        return max(self.least, HALF_ULPS * float(parts.max()))

    def backward(self, S: Polytope, deflation: float) -> Polytope:
        """See :meth:`Recursion.backward`."""
        H = np.concatenate([S.H, self.new_normals])
        h = np.concatenate([S.h, planar_support(S, self.new_normals)])
        return self._back_through_plant(Polytope(H, h + support(self.BU, H)), deflation)


class SpatialRecursion(Recursion):
    """Three or four states."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario)
        inputs = scenario.control.inputs
        self._faces: tuple[Polytope | None, Indices] = (
            None,
            np.zeros((0, scenario.n), dtype=np.intp),
        )
        self.M, self.c = self._cancelling()
        self.intervals: list[tuple[float, float]] | None = None
        if scenario.m == 1:
            self.intervals = [input_interval(inputs)]
        elif inputs.half_widths is not None:
            self.intervals = [(-w, w) for w in inputs.half_widths]

    def erode(self, T: Polytope) -> tuple[Polytope, Polytope, float]:
        """See :meth:`Recursion.erode`."""
        T = spatial_reduce(T)[0]
        S, faces, V = spatial_faces(Polytope(T.H, T.h - support(self.DV, T.H)))
        self._faces = (S, faces)
        # Of each facet at each of its corners.
        added = np.abs(S.H)[faces] @ (np.abs(V) @ self.M.T + self.c)[:, :, None]
        self.spread = float((added[:, :, 0] / S.h[faces]).max())
        return T, S, self.least

    def backward(self, S: Polytope, deflation: float) -> Polytope:
        """See :meth:`Recursion.backward`."""
        if self.intervals is None:
            p = spatial_add_polygon(S, self.BU)
        else:
            # Qhull's work is the time: what it said of S in `erode` serves again, and the sum's
            # redundant rows go when the next `erode` meets them.
            known, faces = self._faces
            if known is not S:
                S, faces, _ = spatial_faces(S)
            segments = zip(self.B.T, self.intervals, strict=True)
            p = spatial_add_segments(S, faces, [(-b, *ends) for b, ends in segments])
        return self._back_through_plant(p, deflation)


def _condition_matrix(A: Array) -> Array | None:
    """abs(A) abs(A^-1); None where A counts as singular.

    Its spectral radius is the least condition number of A in any units of the states (Bauer 1963).
    """
    try:
        M: Array = np.abs(A) @ np.abs(np.linalg.inv(A))
    except np.linalg.LinAlgError:
        return None
    if not np.isfinite(M).all() or not np.abs(np.linalg.eigvals(M)).max() < CONDITION:
        return None
    return M


def _compact(field: str, s: ConvexSet) -> Array:
    """Corners of a scenario's set, or one line that names it."""
    try:
        return set_corners(s)
    except SetError as error:
        raise SynthesisError(f"{field}: {error}, expected a compact one") from None


def recursion(scenario: Scenario) -> Recursion:
    """The recursion for the scenario's number of states, 1 to 4."""
    if scenario.n == 1:
        return IntervalRecursion(scenario)
    return PlanarRecursion(scenario) if scenario.n == 2 else SpatialRecursion(scenario)


def _same(p: Polytope, q: Polytope) -> bool:
    """Whether two irredundant sets are equal to within GROWTH."""
    if p.facets != q.facets:
        return False
    a, b = (
        s.H[np.lexsort(np.round(s.H, 6).T)] / s.h[np.lexsort(np.round(s.H, 6).T), None]
        for s in (p, q)
    )
    return bool((np.abs(a - b) <= GROWTH * np.abs(a).max(axis=1, keepdims=True)).all())
