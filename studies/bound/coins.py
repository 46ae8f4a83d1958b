"""Bits that any tap leaves of the coins, if she watches the machine through noise and no more.

The loop is x+ = A x + B (K x + p_b) + d: linear, its coins b drawn fairly and apart from all else.
She sees Y = S p + (what is known to her) + N, where N holds white Gaussian noise of covariance S_n
a step, and S is the loop's response to the offsets. With g = || S_n^(-1/2) C (zI - A - BK)^(-1) B
|| (the largest gain over frequencies) S'S <= g^2, so that Y is a degraded version of
p + N(0, I / g^2): each coin seen once, by itself, through one Gaussian channel. Whatever she
computes, knowing d, its law, the model and the control law, is then bounded by that channel: the
theorem of docs/findings.md.

Its proof: in units of S_n, S'S <= g^2 I, for S is a block of a Toeplitz operator of norm g. The
sufficient S'Y has the law of S'S q plus independent Gaussian noise of covariance
S'S - (S'S)^2 / g^2 >= 0, for q = p + N(0, I / g^2), in which the coins are apart. Data processing
does the rest.

That of the key's length: Riesz and Thorin between l_1 (norm at most 2) and l_2 (at most 1, as two
inputs collide with probability 2^-length), for the hash less its mean; then Hoelder.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from protocol.arrays import Array

FINE: Final = 64
"""Points of the grid in a standard deviation of the channel's noise."""
TAILS: Final = 9.0
"""Standard deviations beyond the outermost offsets that the grid reaches; 1e-18 lies beyond."""

CLOSE: Final = 1e-9
"""Relative error of the largest gain; it is rounded up by it."""

ORDERS: Final = tuple(1 + 2.0 ** (-k / 4) for k in range(40, -1, -1))
"""Orders s of the Renyi entropy that are tried, from just above 1 to 2."""


def largest_gain(F: Array, B: Array, C: Array) -> float:
    """|| C (zI - F)^(-1) B ||, the largest singular value over the unit circle, rounded up.

    A grid of frequencies gives a value from below; the symplectic pencil says whether a candidate
    is above every frequency's (no eigenvalue on the circle), and else where to look on.

    Parameters
    ----------
    F : array, shape (n, n)
        Stable.
    B, C : array, shapes (n, m) and (p, n)
    """
    n = len(F)

    def at(angles: Array) -> float:
        z = np.exp(1j * angles)[:, None, None] * np.eye(n)
        gains = np.linalg.norm(C @ np.linalg.solve(z - F, B + 0j), ord=2, axis=(1, 2))
        return float(gains.max())

    gain = at(np.linspace(0, np.pi, 2001))
    for _ in range(60):
        tried = gain * (1 + CLOSE)
        angles = _crossings(F, B, C, tried)
        if len(angles) == 0:
            return tried
        ordered = np.sort(angles)
        middles = 0.5 * (ordered + np.roll(ordered, -1))
        middles[-1] = 0.5 * (ordered[-1] + ordered[0] + 2 * np.pi)
        gain = max(at(np.concatenate([ordered, middles])), tried)
    return gain * (1 + 1e-6)


def _crossings(F: Array, B: Array, C: Array, gain: float) -> Array:
    """Angles at which a singular value of the response equals ``gain``."""
    from scipy.linalg import eigvals

    n = len(F)
    eye, zero = np.eye(n), np.zeros((n, n))
    M = np.block([[F, zero], [-C.T @ C, eye]])
    L = np.block([[eye, -(B @ B.T) / gain**2], [zero, F.T]])
    z = eigvals(M, L)
    z = z[np.isfinite(z)]
    out: Array = np.angle(z[np.abs(np.abs(z) - 1) < 1e-7])
    return out


@dataclass(frozen=True, eq=False)
class Coin:
    """One coin seen once: p_b + N(0, deviation^2), b uniform over the offsets; one input.

    Parameters
    ----------
    offsets : array, shape (M, 1)
        Candidates less their common part.
    deviation : float
        1 / g, in the unit of an input.
    """

    offsets: Array
    deviation: float

    @property
    def size(self) -> int:
        """M."""
        return len(self.offsets)

    @cached_property
    def _densities(self) -> Array:
        """P(b, y) on a grid of y, FINE points a deviation; shape (M, points)."""
        P = self.offsets / self.deviation
        first = math.floor((P.min() - TAILS) * FINE)
        last = math.ceil((P.max() + TAILS) * FINE)
        y = np.arange(first, last + 1) / FINE
        out: Array = np.exp(-0.5 * (y - P) ** 2) / math.sqrt(2 * math.pi) / len(P)
        return out

    @cached_property
    def guess(self) -> float:
        """P_g: the probability that the best guess of the coin is right."""
        from scipy.special import ndtr

        sorted_ = np.sort(self.offsets[:, 0])
        edges = np.concatenate([[-np.inf], 0.5 * (sorted_[1:] + sorted_[:-1]), [np.inf]])
        low, high = ((e - sorted_) / self.deviation for e in (edges[:-1], edges[1:]))
        return float((ndtr(high) - ndtr(low)).mean())

    @cached_property
    def bits(self) -> float:
        """H(B | Y), bits a coin that she does not have."""
        joint = self._densities
        with np.errstate(divide="ignore", invalid="ignore"):
            surprise = np.where(joint > 0, -joint * np.log2(joint / joint.sum(axis=0)), 0.0)
        return max(0.0, float(surprise.sum()) / FINE)

    def renyi(self, order: float) -> float:
        """H_s(B | Y) of Arimoto: s / (1 - s) log2 of the integral of (sum_b P(b, y)^s)^(1/s)."""
        norm = float(((self._densities**order).sum(axis=0) ** (1 / order)).sum()) / FINE
        return max(0.0, order / (1 - order) * math.log2(norm))

    def key_bits(self, coins: int, eps: float) -> int:
        """Length of a key that a random Toeplitz matrix, whose seed is public from when the last
        coin has fallen, makes of the bits of so many coins.

        It is within ``eps`` of uniform and apart from all that she has, in the sum of absolute
        differences: twice the statistical distance.
        """

        def length(s: float) -> float:
            return coins * self.renyi(s) - s / (s - 1) * (math.log2(1 / eps) + 2 / s - 1)

        best = max(range(len(ORDERS)), key=lambda i: length(ORDERS[i]))
        low, high = ORDERS[max(0, best - 1)], ORDERS[min(best + 1, len(ORDERS) - 1)]
        finer = np.linspace(low, high, 33).tolist()
        return max(0, math.floor(max(map(length, finer)) - 1e-6))
