"""Whether a tap's misses fit what was claimed of them.

An audit can refute the claim; it can never prove it, for another tap may be better than this one.
"""

import math
from collections.abc import Sequence
from statistics import NormalDist
from typing import Final, NamedTuple

import numpy as np

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


def miss_rate(missed: Sequence[bool], claim: float) -> MissRate:
    """Judge her misses, in the order in which the copies were sent.

    Parameters
    ----------
    missed : sequence of bool
        For each copy 0 whether she missed it.
    claim : float
        eps_E.
    """
    n, k = len(missed), sum(missed)
    low, high = clopper_pearson(k, n, ALPHA) if n else (0.0, 1.0)
    lag, z = 0, 0.0
    if 0 < k < n:
        values = np.asarray(missed, dtype=float) - k / n
        variance = float(values @ values) / n
        for step in range(1, min(LAGS, n // 4) + 1):
            products = values[:-step] @ values[step:]
            found = float(products) / variance / math.sqrt(n - step)
            if abs(found) > abs(z):
                lag, z = step, found
    # the largest of LAGS two-sided values exceeds this with probability ALPHA
    threshold = -NormalDist().inv_cdf(ALPHA / (2 * LAGS))
    return MissRate(k, n, low, high, high < claim, lag, z, z > threshold)
