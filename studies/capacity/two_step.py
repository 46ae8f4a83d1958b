"""Codes over two steps: more keys than two single steps have, by exact clique search.

One input, its offsets counted in half-lengths of D_c, so that d(k) takes all of [-1, 1]; two steps
make points of the plane and everything is measured by the larger coordinate. A code repeats along
a period lattice; each of its q keys stands for a shifted copy of that lattice. Two keys agree with
certainty when their copies are more than 2 apart, so that the defender cannot take one for the
other, and when each copy comes within alpha of every point within 1 of the other, so that the
eavesdropper cannot rule it out. Both depend on the difference of the shifts alone: a code is a
clique.

Shifts lie on a grid, of quarters and of thirds. The period lattices are those on the grid that a
quarter turn leaves as they are, each searched exactly; and beside them every cyclic colouring of a
lattice (2, e), (-e, 2). No code has more than alpha^2 keys (theorem 5 of docs/findings.md): where
that many were found, the search is at its end.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from studies.capacity.blocks import most_keys
from studies.capacity.clique import adjacency, largest_clique

Integers = NDArray[np.int64]

Periods = tuple[tuple[int, int], tuple[int, int]]
"""Two vectors that span a period lattice, in steps of the grid."""

GRIDS = (4, 3)
"""Steps in a half-length of D_c of the grids that are searched. Five keys just above alpha = 7/3
have periods (14, 2) / 3 and (-2, 14) / 3, which no grid of quarters has."""

BRANCHES = 20_000


@dataclass(frozen=True)
class TwoStepCode:
    """A code found.

    Parameters
    ----------
    keys : int
        q; log2(q) / 2 bits a step.
    periods : tuple of (float, float)
        Two vectors that span the period lattice.
    shifts : tuple of (float, float)
        Of each key.
    """

    keys: int
    periods: tuple[tuple[float, float], ...]
    shifts: tuple[tuple[float, float], ...]


NO_CODE = TwoStepCode(1, (), ((0.0, 0.0),))


def _code(periods: Periods, shifts: Integers, grid: int) -> TwoStepCode:
    return TwoStepCode(
        len(shifts),
        tuple((x / grid, y / grid) for x, y in periods),
        tuple((float(x) / grid, float(y) / grid) for x, y in shifts),
    )


def _distance(periods: Periods, points: Integers) -> Integers:
    """Chebyshev distance of points of the half grid to a lattice with nearly square periods."""
    (a, b), (c, d) = periods
    area = 2 * (a * d - b * c)
    x, y = points[..., 0], points[..., 1]
    i = np.floor_divide(2 * (x * d - y * c) + area, 2 * area)
    j = np.floor_divide(2 * (y * a - x * b) + area, 2 * area)
    best = np.full(points.shape[:-1], 1 << 40)
    for p in (-1, 0, 1):
        for q in (-1, 0, 1):
            u = np.abs(x - 2 * ((i + p) * a + (j + q) * c))
            v = np.abs(y - 2 * ((i + p) * b + (j + q) * d))
            best = np.minimum(best, np.maximum(u, v))
    return best


def _window(grid: int) -> Integers:
    """Half-grid points of the square of side 2.

    A Chebyshev distance to grid points has its corners on the half grid, so that the farthest point
    of a square with corners on the grid is among them.
    """
    side = np.arange(-2 * grid, 2 * grid + 1)
    return np.stack(np.meshgrid(side, side, indexing="ij"), axis=2).reshape(-1, 2)


def least_alphas(periods: Periods, shifts: Integers, grid: int) -> NDArray[np.float64]:
    """From which alpha two keys that differ by each shift are together; inf where not 2 apart."""
    apart = _distance(periods, 2 * shifts) >= 2 * 2 * grid
    out = np.full(len(shifts), math.inf)
    near = 2 * shifts[apart, None] + _window(grid)
    out[apart] = _distance(periods, near).max(axis=1) / (2 * grid)
    return out


@dataclass(frozen=True, eq=False)
class _Torus:
    """All shifts modulo the lattice of (a, b) and (-b, a), and the alphas of each.

    Parameters
    ----------
    a, b : int
    grid : int
        Steps in a half-length of D_c.
    shifts : array, shape (a^2 + b^2, 2)
        One representative each.
    alphas : array
        :func:`least_alphas` of them.
    """

    a: int
    b: int
    grid: int
    shifts: Integers
    alphas: NDArray[np.float64]

    @classmethod
    def of(cls, a: int, b: int, grid: int) -> "_Torus":
        common = math.gcd(a, b)
        axes = np.arange((a * a + b * b) // common), np.arange(common)
        shifts = np.stack(np.meshgrid(*axes, indexing="ij"), axis=2).reshape(-1, 2)
        periods = ((a, b), (-b, a))
        return cls(a, b, grid, shifts, least_alphas(periods, shifts, grid))

    def number(self, shifts: Integers) -> Integers:
        """The place of each shift's representative, shape (...)."""
        common = math.gcd(self.a, self.b)
        length = (self.a * self.a + self.b * self.b) // common
        # x (a, b) + y (-b, a) rises by ``common`` where x b + y a = common.
        x, y = _bezout(self.b, self.a)
        turns = np.floor_divide(shifts[..., 1], common)
        column = (shifts[..., 0] - turns * (x * self.a - y * self.b)) % length
        out: Integers = column * common + shifts[..., 1] % common
        return out


def _bezout(p: int, q: int) -> tuple[int, int]:
    """x and y with p x + q y = gcd(p, q)."""
    if q == 0:
        return 1, 0
    x, y = _bezout(q, p % q)
    return y, x - (p // q) * y


def _tori(largest: float, grid: int) -> Iterator[_Torus]:
    """Every quarter-turn lattice with at most this area a period, and room for four keys."""
    most = math.floor(largest * grid * grid)
    for a in range(1, math.isqrt(most) + 1):
        for b in range(a):
            if 16 * grid * grid <= a * a + b * b <= most:
                yield _Torus.of(a, b, grid)


def _search(torus: _Torus, alpha: float, at_least: int) -> TwoStepCode:
    """More than ``at_least`` keys on one period lattice, or no code."""
    if len(torus.shifts) < 4 * torus.grid**2 * (at_least + 1):  # squares of side 2 do not overlap
        return NO_CODE
    allowed = torus.alphas <= alpha + 1e-12
    vertices = np.flatnonzero(allowed)
    if len(vertices) < at_least:
        return NO_CODE
    V = torus.shifts[vertices]
    joined = allowed[torus.number(V[:, None] - V[None])]
    joined &= joined.T
    clique = largest_clique(adjacency(joined), at_least=at_least - 1, most_branches=BRANCHES)
    if not clique.vertices:
        return NO_CODE
    shifts = np.vstack([[[0, 0]], V[list(clique.vertices)]])
    return _code(((torus.a, torus.b), (-torus.b, torus.a)), shifts, torus.grid)


def _reduced(p: tuple[int, int], q: tuple[int, int]) -> Periods:
    """Shortest periods of the same lattice, by Lagrange and Gauss, positively oriented."""
    while True:
        if p[0] ** 2 + p[1] ** 2 > q[0] ** 2 + q[1] ** 2:
            p, q = q, p
        turns = round((p[0] * q[0] + p[1] * q[1]) / (p[0] ** 2 + p[1] ** 2))
        if not turns:
            break
        q = (q[0] - turns * p[0], q[1] - turns * p[1])
    return (p, q) if p[0] * q[1] > p[1] * q[0] else (p, (-q[0], -q[1]))


def colourings(most: int, grid: int) -> Iterator[tuple[float, TwoStepCode]]:
    """Every cyclic colouring i + k j mod q of a lattice (2, e), (-e, 2), with its least alpha."""
    for e in range(2 * grid):
        first, second = (2 * grid, e), (-e, 2 * grid)
        for q in range(2, most + 1):
            for k in range(q):
                along = (second[0] - k * first[0], second[1] - k * first[1])
                periods = _reduced((q * first[0], q * first[1]), along)
                shifts = np.array([(c * first[0], c * first[1]) for c in range(q)])
                alpha = float(least_alphas(periods, shifts[1 : q // 2 + 1], grid).max())
                if alpha < math.inf:
                    yield alpha, _code(periods, shifts, grid)


def best_codes(alphas: list[float]) -> list[TwoStepCode]:
    """The most keys found just above each alpha.

    Parameters
    ----------
    alphas : list of float
        In ascending order; a code for one alpha serves every larger one.
    """
    most = most_keys(max(alphas), 2)
    coloured = [item for grid in GRIDS for item in colourings(most, grid)]
    coloured.sort(key=lambda item: (item[0], -item[1].keys))
    tori = [torus for grid in GRIDS for torus in _tori((2 * max(alphas)) ** 2, grid)]
    out = []
    best = NO_CODE
    for alpha in alphas:
        for least, code in coloured:
            if least <= alpha + 1e-12 and code.keys > best.keys:
                best = code
        for torus in tori:
            if best.keys >= most_keys(alpha, 2):
                break
            best = max(best, _search(torus, alpha, best.keys), key=lambda code: code.keys)
        out.append(best)
    return out


def single_step_keys(alpha: float) -> int:
    """The most keys of one step just above ``alpha``, erasures at the alphabet's ends allowed."""
    return math.floor(alpha + 1e-12)
