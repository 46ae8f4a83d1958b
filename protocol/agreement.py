"""The agreement test: the one function that both ends evaluate, and must evaluate to the same bit.

A single disagreement at a set's edge puts the automata out of step for good. So the test works only
on what both ends hold, in plain Python floats, in a fixed order of operations: no BLAS, no fused
multiply-add, no order left to a library. The key is what this function returns, on both sides.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import inf
from operator import sub
from typing import Final, NamedTuple

from protocol.box_observer import Box, Estimate
from protocol.vectors import Matrix, Vector

NO_SYMBOL = -1
"""Stands for a key symbol where none was agreed."""

INSIDE: Final = 1.0 + 1e-9
"""A gauge of D_c up to this counts as inside. x_next is a sum that rounds; a disturbance on the
edge of D_c that fell out would let the other candidate be decoded."""


def predict(A: Matrix, B: Matrix, x: Sequence[float], u: Sequence[float]) -> Vector:
    """The centre c = A x + B u (equation 5 without its disturbance).

    Products are added from the left, first over the columns of A, then over those of B.

    Parameters
    ----------
    A, B : tuple of tuple of float, shapes (n, n) and (n, m)
    x, u : sequence of float, shapes (n,) and (m,)

    Returns
    -------
    tuple of float, shape (n,)
    """
    if len(x) == 2 and len(u) == 1:  # the paper's plant, unrolled: the same products and order
        (a00, a01), (a10, a11) = A
        (b0,), (b1,) = B
        x0, x1 = x
        u0 = u[0]
        return (a00 * x0 + a01 * x1 + b0 * u0, a10 * x0 + a11 * x1 + b1 * u0)
    centre = []
    for row_a, row_b in zip(A, B, strict=True):
        total = row_a[0] * x[0]
        for j in range(1, len(row_a)):
            total += row_a[j] * x[j]
        for j in range(len(row_b)):
            total += row_b[j] * u[j]
        centre.append(total)
    return tuple(centre)


@dataclass(frozen=True, slots=True)
class Gauge:
    """g(v) = min{ t >= 0 : v in t S } of a convex set S with the origin inside.

    For a box it is the largest ``abs(v_i) / half_widths_i``; for { v : H v <= h } the largest
    ``(H v)_j / h_j``, and never below zero. No set is built to evaluate it.
    """

    half_widths: Vector | None = None
    H: Matrix = ()
    h: Vector = ()

    @classmethod
    def from_rows(cls, H: Matrix, h: Vector) -> "Gauge":
        """The gauge of { v : H v <= h }; rows that come as +-e_i in pairs make it a box's."""
        n = len(H[0])
        if len(H) == 2 * n:
            widths = []
            for i in range(n):
                unit = tuple(1.0 if j == i else 0.0 for j in range(n))
                opposite = tuple(-1.0 if j == i else 0.0 for j in range(n))
                if H[2 * i] != unit or H[2 * i + 1] != opposite or h[2 * i] != h[2 * i + 1]:
                    break
                widths.append(h[2 * i])
            else:
                return cls(half_widths=tuple(widths))
        return cls(H=H, h=h)

    def __call__(self, v: Sequence[float]) -> float:
        """Evaluate at ``v``, shape (n,)."""
        widths = self.half_widths
        if widths is not None:
            if len(widths) == 2:
                a = abs(v[0]) / widths[0]
                b = abs(v[1]) / widths[1]
                return a if a >= b else b
            if len(widths) == 1:
                return abs(v[0]) / widths[0]
            return max(abs(c) / w for c, w in zip(v, widths, strict=True))
        largest = 0.0
        for row, bound in zip(self.H, self.h, strict=True):
            total = row[0] * v[0]
            for j in range(1, len(row)):
                total += row[j] * v[j]
            ratio = total / bound
            largest = max(largest, ratio)
        return largest


def spread(gauge: Gauge, centres: Sequence[Sequence[float]]) -> float:
    """The largest gauge of a difference of two centres, either way round."""
    return max(gauge(tuple(map(sub, one, other))) for one in centres for other in centres)


class AgreementResult(NamedTuple):
    """What the test says of one transition.

    ``gauges`` holds g(x_next - c_i) for each candidate; ``symbol`` is the key symbol, or
    :data:`NO_SYMBOL` where x_next is outside Diff. ``inside`` counts the candidates that the
    defender finds possible: with 1 and no symbol, one is impossible for the eavesdropper. Where
    some outputs alone are read, ``box`` is where the state was; ``estimate`` is what is kept.
    """

    gauges: Vector
    symbol: int
    inside: int = 0
    box: Box | None = None
    estimate: Estimate | None = None

    @property
    def unexplained(self) -> bool:
        """Whether no candidate leads to x_next with d in D_c: its disturbance has left D_c."""
        return not min(self.gauges) <= INSIDE

    @property
    def agreed(self) -> bool:
        """Whether a key symbol was agreed."""
        return self.symbol != NO_SYMBOL


@dataclass(frozen=True, slots=True)
class AgreementRule:
    """Equation (20) as a test on one transition, for M >= 2 candidates.

    x_next is in Diff when every candidate's gauge, of D_c or of ``reach``, is at most alpha (all
    are possible for the eavesdropper) and exactly one is at most 1 in that of D_c, to rounding (one
    only is possible for the defender). The key symbol is that one's index (equations 21 and 22).

    Parameters
    ----------
    A, B : tuple of tuple of float, shapes (n, n) and (n, m)
        The shared model f_c.
    gauge : Gauge
        The gauge of D_c.
    alpha : float
        D_e = alpha D_c.
    reach : Gauge, optional
        Where D_e has a shape of its own: the gauge of D_e over alpha.
    apart : Gauge, optional
        Where sensors are noisy and ``gauge`` is that of W: the gauge of D_c. All candidates are
        then possible for Eve where their centres are at most alpha - 1 apart in it, whatever x_next
        is: d + B (u_b - u_i) is in D_e for every d in D_c, and gives the same readings for ever.
    deviations : tuple of float, shape (n,), optional
        Of a Gaussian d, a state each. The symbol is then the likeliest candidate, in every
        transition and whatever the sets say, and it may be wrong.
    """

    A: Matrix
    B: Matrix
    gauge: Gauge
    alpha: float
    reach: Gauge | None = None
    apart: Gauge | None = None
    deviations: Vector | None = None

    def verdict(
        self, x: Sequence[float], candidates: Sequence[Sequence[float]], x_next: Sequence[float]
    ) -> AgreementResult:
        """Evaluate the test for x(k) = ``x``, the offered inputs and x(k+1) = ``x_next``."""
        A, B = self.A, self.B
        return self.verdict_at([predict(A, B, x, u) for u in candidates], x_next)

    def widest(self, predictions: Iterable[Sequence[float]], x_next: Sequence[float]) -> float:
        """The largest gauge of D_e over alpha: up to alpha Eve finds every candidate possible."""
        gauge = self.gauge if self.reach is None else self.reach
        if self.apart is not None:
            return 1.0 + spread(self.apart, list(predictions))
        return max(gauge(tuple(map(sub, x_next, centre))) for centre in predictions)

    def verdict_at(
        self, predictions: Iterable[Sequence[float]], x_next: Sequence[float]
    ) -> AgreementResult:
        """Evaluate it for predictions c_i = f_c(x(k), u_i) that are given."""
        gauges = []
        symbol = NO_SYMBOL
        inside = 0
        possible = True
        gauge, alpha, reach = self.gauge, self.alpha, self.reach
        if self.apart is not None:
            predictions = list(predictions)
            possible = 1.0 + spread(self.apart, predictions) <= alpha
            alpha = inf
        unlikeliness = []
        for i, centre in enumerate(predictions):
            difference = tuple(map(sub, x_next, centre))
            g = gauge(difference)
            gauges.append(g)
            if self.deviations is not None:
                unlikeliness.append(deviation(difference, self.deviations))
            fits = g <= INSIDE  # no branch: the verdict must not show in the time it takes
            inside += fits
            symbol = i if fits else symbol
            possible &= (g if reach is None else reach(difference)) <= alpha
        if unlikeliness:
            return AgreementResult(tuple(gauges), unlikeliness.index(min(unlikeliness)), inside)
        return AgreementResult(
            tuple(gauges), symbol if inside == 1 and possible else NO_SYMBOL, inside
        )


def deviation(v: Sequence[float], deviations: Sequence[float]) -> float:
    """The sum of squares of ``v`` in standard deviations, added from the left."""
    total = 0.0
    for a, s in zip(v, deviations, strict=True):
        total += (a / s) * (a / s)
    return total


def fails(gauges: Sequence[float], digit: int) -> bool:
    """Whether a transition is not the keyed candidate's: g(x(k+1) - f_c(x(k), v + p_b)) > 1.

    Parameters
    ----------
    gauges : sequence of float, M of them
        :attr:`AgreementResult.gauges`, with its tolerance.
    digit : int
        b.
    """
    return not gauges[digit] <= INSIDE
