"""Alphabets closer than certain: with what probability a transition agrees on each symbol.

At spacing 1 and alpha = 2 two candidates agree in half of all transitions, if d is uniform in
D = D_c / 1.2 as in the paper. Whoever counts on that bets on the law of d. A lost bet is an
erasure, never an error: the test says so, to both ends alike.
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from protocol.agreement import INSIDE
from protocol.arrays import Array
from protocol.scenario import Disturbance

Cumulative = Callable[[Array], Array]


@dataclass(frozen=True, eq=False)
class DisturbanceLaw:
    """The law of d: independent components, or equally likely points.

    Parameters
    ----------
    cumulative : tuple of callable, length n
        P(d_i <= v) of each component; empty for points.
    points : array, shape (points, n)
    """

    cumulative: tuple[Cumulative, ...]
    points: Array

    @classmethod
    def of(cls, spec: Disturbance) -> "DisturbanceLaw":
        """The law of a scenario's disturbance."""
        w = np.array(spec.half_widths)
        if spec.kind in ("corners", "constant", "sinusoid"):
            if spec.kind == "corners":
                factors = np.array(list(itertools.product((-1.0, 1.0), repeat=len(w))))
            elif spec.kind == "constant":
                factors = np.full((1, len(w)), spec.bias)
            else:
                steps = np.arange(spec.cycle_steps)
                factors = np.sin(2 * np.pi * steps / spec.cycle_steps)[:, None] * np.ones(len(w))
            return cls((), factors * w)
        return cls(tuple(_cumulative(spec, float(v)) for v in w), np.zeros((0, len(w))))

    def measure(self, edges: list[Array]) -> Array:
        """Probability of each cell between the edges of each axis, one axis of the result each."""
        mass = np.ones(())
        for cumulative, edge in zip(self.cumulative, edges, strict=True):
            mass = np.multiply.outer(mass, np.diff(cumulative(edge)))
        return mass


def _cumulative(spec: Disturbance, w: float) -> Cumulative:
    from scipy.special import ndtr

    if w == 0:
        return lambda v: (v >= 0).astype(float)
    if spec.kind == "uniform":
        return lambda v: np.clip((v / w + 1) / 2, 0.0, 1.0)
    scale = spec.deviation * w
    if spec.kind == "gaussian":
        return lambda v: np.asarray(ndtr(v / scale))
    low = float(ndtr(-1 / spec.deviation))
    return lambda v: np.clip((ndtr(v / scale) - low) / (1 - 2 * low), 0.0, 1.0)


def chances(predictions: Array, widths: Array, alpha: float, law: DisturbanceLaw) -> Array:
    """Probability that a transition agrees on the candidate applied, for each candidate.

    Parameters
    ----------
    predictions : array, shape (M, n)
        B u of each candidate.
    widths : array, shape (n,)
        Half-widths of D_c, a box.
    alpha : float
    law : DisturbanceLaw

    Returns
    -------
    array, shape (M,)
        Exact: the agreed part of D_c is a box less boxes, and is measured cell by cell.
    """
    out = []
    for r, centre in enumerate(predictions):
        shift = np.delete(centre - predictions, r, axis=0)  # x+ - c_s = d + shift_s
        if len(law.points):
            g = np.abs(law.points / widths).max(axis=1)
            others = (np.abs(law.points[:, None] + shift) / widths).max(axis=2)
            agreed = (g <= INSIDE) & (others > INSIDE).all(axis=1) & (others <= alpha).all(axis=1)
            out.append(float(agreed.mean()))
        else:
            out.append(_box_less_boxes(shift, widths, alpha, law))
    return np.array(out)


def _box_less_boxes(shift: Array, widths: Array, alpha: float, law: DisturbanceLaw) -> float:
    low = np.maximum(-widths, (-alpha * widths - shift).max(axis=0))
    high = np.minimum(widths, (alpha * widths - shift).min(axis=0))
    if not (low < high).all():
        return 0.0
    taken_low, taken_high = np.maximum(-widths - shift, low), np.minimum(widths - shift, high)
    taken = (taken_low < taken_high).all(axis=1)
    taken_low, taken_high = taken_low[taken], taken_high[taken]
    edges = [
        np.unique(np.concatenate([[low[i], high[i]], taken_low[:, i], taken_high[:, i]]))
        for i in range(len(widths))
    ]
    covered = np.zeros([len(e) - 1 for e in edges], dtype=bool)
    for a, b in zip(taken_low, taken_high, strict=True):
        span = tuple(
            slice(int(np.searchsorted(e, a[i])), int(np.searchsorted(e, b[i])))
            for i, e in enumerate(edges)
        )
        covered[span] = True
    return float(law.measure(edges)[~covered].sum())


class Bet(NamedTuple):
    """The best alphabet for one law of d: bits a transition, M, and the spacing."""

    bits: float
    size: int
    spacing: float


def best_bet(
    b: Array,
    sigma: float,
    widths: Array,
    alpha: float,
    law: DisturbanceLaw,
    *,
    length: float = math.inf,
    certain: int = 1,
) -> Bet:
    """Best progression of one input with a fair coin, over M and the spacing.

    Parameters
    ----------
    b : array, shape (n,)
        The column of B.
    sigma : float
        Spacing 2, as an input.
    length : float
        Of U: the progression fits in it.
    certain : int
        The largest M that is certain; that and two above are tried.
    """

    def bits(size: int, spacing: float) -> float:
        step = spacing / 2 * sigma
        if (size - 1) * step > length:
            return 0.0
        predictions = np.arange(size)[:, None] * (step * b)
        return math.log2(size) * float(chances(predictions, widths, alpha, law).mean())

    best = Bet(0.0, 1, 2.0)
    widest = 2.0 * (1 + 1e-6)
    for size in range(max(2, certain), certain + 3):
        coarse = np.linspace(0.05, widest, 40).tolist()
        at = coarse[int(np.argmax([bits(size, s) for s in coarse]))]
        for s in np.linspace(max(at - 0.05, 0.01), min(at + 0.05, widest), 41).tolist():
            value = bits(size, s)
            if value > best.bits + 1e-12:
                best = Bet(value, size, s)
    return best
