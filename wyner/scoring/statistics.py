"""Intervals: Wilson for proportions, the bootstrap over runs for rates, the normal for costs.

The unit that is drawn independently is a run; the steps of a run depend on each other. So a rate's
interval resamples runs, never steps. A sweep keeps, instead of each run's count, how many runs had
each count: resampling runs is then one multinomial draw.
"""

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np

CONFIDENCE: Final = 0.95
RESAMPLES: Final = 2000
SEED: Final = 0


class Interval(NamedTuple):
    """An estimate with the limits of its confidence interval."""

    value: float
    low: float
    high: float

    @property
    def width(self) -> float:
        """Upper limit minus lower."""
        return self.high - self.low

    @property
    def relative_width(self) -> float:
        """Width over the estimate; infinite where the estimate is zero."""
        return self.width / abs(self.value) if self.value else float("inf")

    def scaled(self, factor: float) -> "Interval":
        """Estimate and limits times a positive factor."""
        return Interval(self.value * factor, self.low * factor, self.high * factor)


def _quantile(confidence: float) -> float:
    from scipy.special import ndtri

    if not 0 < confidence < 1:
        raise ValueError(f"confidence: got {confidence}, expected between 0 and 1")
    return float(ndtri(0.5 + confidence / 2))


def wilson(successes: int, trials: int, confidence: float = CONFIDENCE) -> Interval:
    """Wilson's score interval of a proportion (Wilson 1927), for independent trials.

    Raises
    ------
    ValueError
        When there is no trial, or more successes than trials.
    """
    if not 0 <= successes <= trials or trials < 1:
        raise ValueError(f"got {successes} successes of {trials} trials, expected 0 to trials >= 1")
    z = _quantile(confidence)
    p = successes / trials
    scale = 1 + z * z / trials
    centre = (p + z * z / (2 * trials)) / scale
    half = z * ((p * (1 - p) + z * z / (4 * trials)) / trials) ** 0.5 / scale
    low = 0.0 if successes == 0 else centre - half
    high = 1.0 if successes == trials else centre + half
    return Interval(p, low, high)


def bootstrap_mean(
    histogram: Mapping[int, int],
    *,
    confidence: float = CONFIDENCE,
    resamples: int = RESAMPLES,
    seed: int = SEED,
) -> Interval:
    """Mean of a count over runs, with its percentile bootstrap interval (Efron 1979).

    Parameters
    ----------
    histogram : mapping of int to int
        How many runs had each value of the count.
    confidence : float
    resamples : int
    seed : int
        Of the resampling: the same histogram gives the same interval.

    Raises
    ------
    ValueError
        When there is no run.
    """
    values = np.array(sorted(histogram), dtype=float)
    counts = np.array([histogram[v] for v in sorted(histogram)], dtype=np.int64)
    runs = int(counts.sum())
    if runs < 1 or (counts < 0).any():
        raise ValueError(f"histogram: got {dict(histogram)}, expected at least one run")
    if not 0 < confidence < 1:
        raise ValueError(f"confidence: got {confidence}, expected between 0 and 1")
    value = float((values * counts).sum() / runs)
    drawn = np.random.default_rng(seed).multinomial(runs, counts / runs, size=resamples)
    means = (drawn * values).sum(axis=1) / runs
    tail = (1 - confidence) / 2
    low, high = np.quantile(means, [tail, 1 - tail])
    return Interval(value, float(low), float(high))


def normal_mean(
    total: float, squares: float, runs: int, confidence: float = CONFIDENCE
) -> Interval:
    """Mean over runs from the sums of values and of squares, with the normal interval.

    Raises
    ------
    ValueError
        When there are fewer than two runs.
    """
    if runs < 2:
        raise ValueError(f"runs: got {runs}, expected at least 2")
    mean = total / runs
    variance = max(0.0, (squares - runs * mean * mean) / (runs - 1))
    half = _quantile(confidence) * (variance / runs) ** 0.5
    return Interval(mean, mean - half, mean + half)
