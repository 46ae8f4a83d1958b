"""How large D_c must be, and how sure one is of it, counted in whole sessions.

A hundred sessions, none of which left D_c: with confidence 0.999 the next one leaves it with
probability at most 0.067, for a plant that leaves it more often would have shown it.

The steps of one loop depend on each other; sessions that start alike do not. So a session has one
score, the largest of its steps, and what is promised is promised of sessions.
"""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from protocol.arrays import Array
from protocol.statistics import clopper_pearson

CONFIDENCE: Final = 0.999
"""Of what is said of D_c."""


def template(residuals: Array) -> Array:
    """Half-widths of the smallest box about all residuals, shape (n,).

    Parameters
    ----------
    residuals : array, shape (..., n)
        Of a pilot run under the law that will be used.
    """
    out: Array = np.abs(residuals).reshape(-1, residuals.shape[-1]).max(axis=0)
    return out


def rank(sessions: int, violation: float) -> int:
    """k = ceil((1 - violation)(N + 1)), the score that split conformal prediction takes.

    Raises
    ------
    ValueError
        When there are too few sessions for it.
    """
    k = math.ceil((1.0 - violation) * (sessions + 1) - 1e-9)
    if k > sessions:
        needed = math.ceil(1.0 / violation - 1.0 - 1e-9)
        raise ValueError(
            f"got {sessions} sessions, expected at least {needed} for a violation of {violation:g}"
        )
    return max(k, 1)


def conformal_scale(scores: Sequence[float], violation: float) -> float:
    """The scale q of the template: the next session leaves q times it with at most ``violation``.

    The probability is over both the calibration's sessions and the next one, and at most
    1 - k / (N + 1) with k of :func:`rank` (split conformal prediction: Papadopoulos et al. 2002,
    Vovk et al. 2005).
    """
    return sorted(scores)[rank(len(scores), violation) - 1]


def violation_bound(sessions: int, exceeded: int) -> float:
    """Upper bound of the probability that a session leaves D_c, after ``exceeded`` of N did.

    That of Clopper and Pearson, one-sided, which holds with :data:`CONFIDENCE`. With none exceeded
    it is 1 - (1 - CONFIDENCE)^(1 / N).
    """
    return clopper_pearson(exceeded, sessions, 1 - CONFIDENCE)[1]
