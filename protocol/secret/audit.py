"""What a tap holds of a block, exactly, and whether her misses fit what was claimed of them.

She missed e of the counted copies; the block has R rows. Elimination over the field says how many
combinations of rows she can compute: R - min(R, e) for the Cauchy matrix, so w max(0, R - e) bits.
An audit can refute the claim; it can never prove it, for another tap may be better than this one.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from protocol.secret.bound import clopper_pearson
from protocol.secret.extractor import cauchy, words
from protocol.secret.galois import Words, eliminate, product
from protocol.secret.nonces import NONCE_BYTES

ALPHA: Final = 1e-6
"""Chance that a verdict on her miss rate is wrong."""

LAGS: Final = 8
"""Lags at which her misses are looked at for bursts."""


class Held(NamedTuple):
    """What she can compute of a block's rows.

    Parameters
    ----------
    rows : int
    missed : int
        Counted copies that she missed.
    bits : int
        Dimension of what she knows of the rows, times the bits of a row.
    combinations : array, shape (bits / w, rows)
        Combinations of rows that she knows.
    values : array, shape (bits / w, words)
        Their values, as she computes them from the copies she heard.
    """

    rows: int
    missed: int
    bits: int
    combinations: Words
    values: Words


def held(nonces: Sequence[bytes | None], rows: int) -> Held:
    """Solve the block's linear system for whatever the tap can.

    Parameters
    ----------
    nonces : sequence of bytes or None
        The counted copies in order; None where she missed one.
    rows : int
        R, rows of the block, the public one included.
    """
    missed = [j for j, nonce in enumerate(nonces) if nonce is None]
    heard = [j for j, nonce in enumerate(nonces) if nonce is not None]
    G = cauchy(rows, len(nonces))
    unit = np.eye(rows, dtype=np.uint16)
    reduced, rank = eliminate(np.hstack((G[:, missed], unit)), len(missed))
    combinations = reduced[rank:, len(missed) :]
    present = [nonce for nonce in nonces if nonce is not None]
    known = product(G[:, heard], words(present))
    return Held(
        rows=rows,
        missed=len(missed),
        bits=8 * NONCE_BYTES * (rows - rank),
        combinations=combinations,
        values=product(combinations, known),
    )


def bits_held(rows: int, missed: int) -> int:
    """What :func:`held` counts, without the algebra: every square part is invertible."""
    return 8 * NONCE_BYTES * max(0, rows - missed)


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
    threshold = -_normal_quantile(ALPHA / (2 * LAGS))
    return MissRate(k, n, low, high, high < claim, lag, z, z > threshold)


def _normal_quantile(p: float) -> float:
    from statistics import NormalDist

    return NormalDist().inv_cdf(p)
