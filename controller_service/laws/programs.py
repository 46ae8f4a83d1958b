"""Index and programs of any plant with a design: one or two inputs, up to four states.

Facet by facet, elementwise, in a fixed order; one state is a row of many, so both paths agree to
the last bit for a single input. With two inputs each program goes to DAQP (a dual active set, exact
up to rounding), on the rows that some admissible input can violate, tightened; OSQP, at tolerances
of 1e-9 and polished, is asked when DAQP's answer fails the check. No answer leaves unchecked.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from controller_service.sets.design import Design, set_corners
from controller_service.tolerances import CHAIN_PARALLEL, SOLVER_MARGIN, SOLVER_TOLERANCE
from protocol.arrays import Array, Indices
from protocol.convex import Polytope
from protocol.scenario import ConvexSet, Cost

ROWS_AT_ONCE = 2_000_000
"""Products held at a time when many states meet many facets (16 MB)."""


def diagonal(weights: float | tuple[float, ...], size: int) -> Array:
    """A cost's weights as a vector."""
    return np.broadcast_to(np.asarray(weights, dtype=float), (size,)).copy()


def products(H: Array, X: Array) -> Array:
    """H x for each row x of X, shape (R, r), added from the left: elementwise, no BLAS."""
    total = X[:, 0, None] * H[:, 0]
    for k in range(1, H.shape[1]):
        total = total + X[:, k, None] * H[:, k]
    return total


@dataclass(frozen=True, eq=False)
class Quadratic:
    """J(u) = 1/2 u' P u + (F x)' u, of a :class:`protocol.scenario.Cost` without its constant.

    Parameters
    ----------
    P : array, shape (m, m)
    F : array, shape (m, n)
    """

    P: Array
    F: Array

    @classmethod
    def of(cls, A: Array, B: Array, cost: Cost) -> "Quadratic":
        """Expand (A x + B u)' Q (A x + B u) + u' R u.

        Raises
        ------
        ValueError
            When the cost does not grow with every direction of u: its minimiser is not unique.
        """
        Q = diagonal(cost.next_state, len(A))
        R = np.diag(diagonal(cost.input, B.shape[1]))
        P = 2 * (B.T @ (Q[:, None] * B) + R)
        P = 0.5 * (P + P.T)
        values = np.linalg.eigvalsh(P)
        if not values[0] > 1e-12 * max(1e-300, values[-1]):
            raise ValueError("expected weights under which the cost grows with every input")
        return cls(P, 2 * (B.T @ (Q[:, None] * A)))

    def scaled(self, unit: Array) -> "Quadratic":
        """The cost of u / unit, divided by the largest entry of its P."""
        P = self.P * unit * unit[:, None]
        size = P.max()  # on the diagonal: P is positive definite
        return Quadratic(P / size, self.F * unit[:, None] / size)


@dataclass(frozen=True, eq=False)
class Program:
    """The constraints of one target: G u <= h - (H A) x, tightened, and U.

    Parameters
    ----------
    HA, G, h : array, shapes (r, n), (r, m), (r,)
        Each row divided by its offset, so that a solver's tolerances mean the same at any scale.
    spare : float
        By how much each row was tightened.
    reach : array, shape (r,)
        The largest G u over U: a row with more room than this bounds nothing.
    """

    HA: Array
    G: Array
    h: Array
    spare: float
    reach: Array


def solve_daqp(P: Array, f: Array, G: Array, b: Array) -> Array | None:
    """Minimise 1/2 u' P u + f' u subject to G u <= b by DAQP; None without an answer."""
    import daqp

    u, _, flag, _ = daqp.solve(P, f, G, b, primal_tol=SOLVER_TOLERANCE)
    return np.array(u) if flag == 1 else None


def solve_osqp(P: Array, f: Array, G: Array, b: Array) -> Array | None:
    """The same by OSQP, set up afresh, at 1e-9 and polished."""
    import osqp
    from scipy.sparse import csc_matrix

    free = np.asarray(np.linalg.solve(P, -f), dtype=float)
    if (G @ free <= b).all():
        return free  # with no active row OSQP's polishing prints to standard output
    solver = osqp.OSQP()
    solver.setup(
        P=csc_matrix(np.triu(P)),
        q=f,
        A=csc_matrix(G),
        l=np.full(len(b), -np.inf),
        u=b,
        eps_abs=1e-9,
        eps_rel=1e-9,
        max_iter=20000,
        polishing=True,
        verbose=False,
    )
    result = solver.solve(raise_error=False)
    if result.info.status != "solved":
        return None
    return np.array(result.x)


class General:
    """Index and candidates by scanning facets."""

    def __init__(
        self,
        design: Design,
        inputs: ConvexSet,
        costs: Sequence[Cost],
    ) -> None:
        self.N = design.horizon
        self.A, self.B = design.A, design.B
        self.n, self.m = self.B.shape
        # By columns, as they are read.
        self.sets = [Polytope(np.asfortranarray(H), h) for H, h in design.T]
        U = Polytope.from_rows(*inputs.rows())
        self.inputs = Polytope(U.H / U.h[:, None], np.ones(U.facets))
        self.costs = [Quadratic.of(self.A, self.B, cost) for cost in costs]
        corner = set_corners(inputs)
        # The solvers see inputs in this unit, and costs divided by their largest weight.
        self.unit = np.abs(corner).max(axis=0)
        self.solved = [q.scaled(self.unit) for q in self.costs]
        self.free = [np.array(-np.linalg.solve(q.P, q.F), dtype=float) for q in self.costs]
        self.programs = []
        for (H, h), margin in zip(design.targets, design.margins, strict=True):
            scaled = H / h[:, None]
            G = np.ascontiguousarray(scaled @ self.B)
            reach = np.max(corner @ G.T, axis=0)
            self.programs.append(
                Program(
                    np.asfortranarray(scaled @ self.A),
                    G,
                    np.full(len(h), 1 - margin),
                    margin,
                    reach,
                )
            )
        if self.m == 1:
            self.u_min, self.u_max = float(corner.min()), float(corner.max())
            # u = -(F x) / P, the coefficients rounded once.
            self.gains = [-q.F / q.P[0, 0] for q in self.costs]

    def excess(self, x: Sequence[float]) -> float:
        """How far x is outside the largest set, in the unit of its h; zero or less inside."""
        return self.sets[self.N].excess(x)

    def inside(self, i: int, X: Array) -> NDArray[np.bool_]:
        """Whether each row is in T_i."""
        p = self.sets[i]
        step = max(1, ROWS_AT_ONCE // p.facets)
        parts = [
            (products(p.H, X[k : k + step]) <= p.h).all(axis=1) for k in range(0, len(X), step)
        ]
        return np.concatenate(parts) if parts else np.zeros(0, dtype=bool)

    def index(self, x: Sequence[float]) -> int:
        """i(k), or N + 1 outside every set; the trials of :meth:`indices`, without its groups."""
        row = np.array([x], dtype=float)
        low, high, trial = 0, self.N + 1, 0
        while trial < high:
            if self._holds_row(trial, row):
                high = trial
            else:
                low, trial = trial + 1, 2 * trial + 1
        while low < high:
            middle = (low + high) >> 1
            if self._holds_row(middle, row):
                high = middle
            else:
                low = middle + 1
        return low

    def _holds_row(self, i: int, row: Array) -> bool:
        p = self.sets[i]
        return bool((products(p.H, row) <= p.h).all())

    def indices(self, X: Array) -> Indices:
        """i(k) of each row, N + 1 outside every set.

        First 0, 1, 3, 7, ... until a set holds the row, then bisection: a closed loop is nearly
        always at small indices, where the sets have few facets.
        """
        low = np.zeros(len(X), dtype=np.intp)
        high = np.full(len(X), self.N + 1, dtype=np.intp)
        trial, rest = 0, np.arange(len(X))
        while trial <= self.N and len(rest):
            found = self.inside(trial, X[rest])
            high[rest[found]] = trial
            rest = rest[~found]
            low[rest] = trial + 1
            trial = 2 * trial + 1
        while True:
            open_ = np.flatnonzero(low < high)
            if not len(open_):
                return low
            middle = (low[open_] + high[open_]) >> 1
            for i in np.unique(middle):
                group = open_[middle == i]
                found = self.inside(int(i), X[group])
                high[group[found]] = i
                low[group[~found]] = i + 1

    def candidates(self, x: Sequence[float], i: int) -> tuple[tuple[float, ...], ...]:
        """One input for each cost at index i; ValueError without an answer."""
        out = self._answers(np.array([x], dtype=float), i)[0]
        return tuple(tuple(u) for u in out.tolist())

    def candidates_many(self, X: Array, indices: Indices) -> Array:
        """One input for each row and cost, shape (R, M, m); ValueError without an answer."""
        out = np.empty((len(X), len(self.costs), self.m))
        for i in np.unique(indices).tolist():
            group = np.flatnonzero(indices == i)
            step = max(1, ROWS_AT_ONCE // self.sets[i].facets)
            for k in range(0, len(group), step):
                part = group[k : k + step]
                out[part] = self._answers(X[part], i)
        return out

    def _answers(self, X: Array, i: int) -> Array:
        """The candidates of rows of index i, shape (R, M, m)."""
        program = self.programs[max(i - 1, 0)]
        room = program.h - products(program.HA, X)
        if self.m == 1:
            return self._interval(program, room, X)
        out = np.empty((len(X), len(self.costs), self.m))
        for column, (minimiser, scaled) in enumerate(zip(self.free, self.solved, strict=True)):
            # Where the minimiser without constraints satisfies them it is the answer.
            u = products(minimiser, X)
            fits = (products(program.G, u) <= room).all(axis=1)
            fits &= (products(self.inputs.H, u) <= 1 - SOLVER_MARGIN).all(axis=1)
            out[:, column] = u
            for row in np.flatnonzero(~fits).tolist():
                out[row, column] = self._solve(program, room[row], scaled, X[row])
        return out

    def _interval(self, program: Program, room: Array, X: Array) -> Array:
        g = program.G[:, 0]
        limit = CHAIN_PARALLEL * float(np.abs(g).max())
        above, below = g > limit, g < -limit
        high = np.min(room[:, above] / g[above], axis=1, initial=self.u_max)
        low = np.max(room[:, below] / g[below], axis=1, initial=self.u_min)
        if not (low <= high).all():
            row = int((~(low <= high)).argmax())
            raise ValueError(f"no input in [{low[row]!r}, {high[row]!r}]")
        columns = []
        for gain in self.gains:
            u = products(gain, X)[:, 0]
            columns.append(np.where(u < low, low, np.where(u > high, high, u)))
        return np.stack(columns, axis=1)[:, :, None]

    def _solve(self, program: Program, room: Array, cost: Quadratic, x: Array) -> Array:
        """One program at one state, checked."""
        near = program.reach > room
        G = np.concatenate([program.G[near], self.inputs.H]) * self.unit
        b = np.concatenate([room[near], self.inputs.h * (1 - SOLVER_MARGIN)])
        f = cost.F @ x
        for solver in (solve_daqp, solve_osqp):
            v = solver(cost.P, f, G, b)
            if v is None:
                continue
            u: Array = v * self.unit
            if self.holds(program, room, u):
                return u
        raise ValueError("no solver's answer satisfies the constraints")

    def holds(self, program: Program, room: Array, u: Array) -> bool:
        """Whether u is in U and steers into the target, which is wider than the program's."""
        # Half the tightening is left for the plant's own rounding.
        return bool(
            (program.G @ u <= room + 0.5 * program.spare).all()
            and (self.inputs.H @ u <= self.inputs.h).all()
        )
