"""Whether a tap's misses fit what was claimed of them.

An audit can refute the claim; it can never prove it, for another tap may be better than this one.
"""

import math
from collections.abc import Iterable
from statistics import NormalDist
from typing import Final, NamedTuple

from protocol.secret.bound import clopper_pearson

ALPHA: Final = 1e-6
"""Chance that a verdict on her miss rate is wrong."""

LAGS: Final = 8
"""Lags at which her misses are looked at for bursts."""


class MissRate(NamedTuple):
    """Her misses over many copies, against the claim.

    ``low`` and ``high`` bound her miss rate (Clopper-Pearson); ``refuted`` says that even ``high``
    is below the claim. ``lag`` is where misses are correlated most, ``z`` how many standard
    deviations that is from none, ``bursts`` whether it is more than chance explains.
    """

    missed: int
    copies: int
    low: float
    high: float
    refuted: bool
    lag: int
    z: float
    bursts: bool


class Misses:
    """Her misses one by one, in the order in which the copies were sent; memory stays bounded."""

    def __init__(self) -> None:
        self._copies = self._missed = 0
        self._together = [0] * LAGS  # misses that stand 1, 2, ... copies after another
        self._first = 0  # the first LAGS copies and the last ones, a bit each, the newest lowest
        self._last = 0

    def add(self, *, missed: bool) -> None:
        """Take the next copy."""
        if missed:
            self._missed += 1
            for lag in range(LAGS):
                self._together[lag] += self._last >> lag & 1
        self._last = (self._last << 1 | missed) & (1 << LAGS) - 1
        if self._copies < LAGS:
            self._first = self._last
        self._copies += 1

    def judge(self, claim: float) -> MissRate:
        """Judge them against the claim eps_E."""
        n, k = self._copies, self._missed
        low, high = clopper_pearson(k, n, ALPHA) if n else (0.0, 1.0)
        lag, z = 0, 0.0
        if 0 < k < n:
            mean = k / n
            kept = min(n, LAGS)
            for step in range(1, min(LAGS, n // 4) + 1):
                last = (self._last & (1 << step) - 1).bit_count()
                first = (self._first >> kept - step).bit_count()
                products = self._together[step - 1] - mean * (2 * k - first - last)
                products += (n - step) * mean * mean
                found = products / (mean * (1 - mean)) / math.sqrt(n - step)
                if abs(found) > abs(z):
                    lag, z = step, found
        # the largest of LAGS two-sided values exceeds this with probability ALPHA
        threshold = -NormalDist().inv_cdf(ALPHA / (2 * LAGS))
        return MissRate(k, n, low, high, high < claim, lag, z, z > threshold)


def miss_rate(missed: Iterable[bool], claim: float) -> MissRate:
    """Judge her misses, in the order in which the copies were sent.

    Parameters
    ----------
    missed : iterable of bool
        For each copy 0 whether she missed it.
    claim : float
        eps_E.
    """
    misses = Misses()
    for one in missed:
        misses.add(missed=one)
    return misses.judge(claim)
