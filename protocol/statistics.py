"""Intervals, one for each way of looking, for the tap, the screens and the studies alike.

What is drawn independently is a run: its steps depend on each other. So a share or a mean over runs
has an interval over runs (:func:`share_over_runs`, :func:`mean_over_runs`), and fewer than
:data:`FEWEST_RUNS` runs have none. What is looked at again and again, with a decision at each look,
has a confidence sequence, which holds at all looks together (:func:`confidence_sequence`).
:func:`wilson` is for trials that are independent, such as one per run, :func:`clopper_pearson` for
the same where a bound must never be too narrow, :func:`normal` for an estimate whose standard error
is known.

Limits that are not known are NaN: :attr:`Interval.known` asks, :meth:`Interval.text` says so.
"""

from collections import Counter
from collections.abc import Iterable, Mapping
from math import inf, isfinite, isnan, lgamma, log, log2, nan, sqrt
from statistics import NormalDist
from typing import Final, NamedTuple

CONFIDENCE: Final = 0.95
FEWEST_RUNS: Final = 5
"""Fewer runs than this have no interval over runs: too little is known of how runs differ."""

FEW_RUNS: Final = 20
"""Fewer runs than this may be alike by chance."""

NO_RUNS: Final = f"fewer than {FEWEST_RUNS} runs, or all alike: they do not tell how runs differ"
NOT_COUNTED: Final = "nothing was counted"
COUNTED: Final = "a count of this run, no estimate"
POOLED: Final = "both directions together; each has its limits in audited"
COMPUTED: Final = "computed from the scenario, not measured"
PROVED: Final = "a proved bound, not measured"
GIVEN: Final = "given to the run, not measured"
STATED: Final = "a bound that is stated, with its confidence"
"""Why a figure has no interval, as ``no_interval`` says it in what is printed for machines.

It stands beside the figures that it is about: a text is about all of an object, a table names them.
"""

RESAMPLES: Final = 10_000
SEED: Final = 0


class Interval(NamedTuple):
    """An estimate with the limits of its confidence interval; ``math.nan`` where there is none.

    It is always that one NaN, so that intervals without limits compare as equal.
    """

    value: float
    low: float = nan
    high: float = nan

    @property
    def known(self) -> bool:
        """Whether it has limits."""
        return not (isnan(self.low) or isnan(self.high))

    @property
    def width(self) -> float:
        """Upper limit minus lower."""
        return self.high - self.low

    def scaled(self, factor: float) -> "Interval":
        """Estimate and limits times a positive factor."""
        return Interval(*(nan if isnan(x) else x * factor for x in self))

    def complement(self) -> "Interval":
        """One minus it: an error rate of a share."""
        value, high, low = (nan if isnan(x) else 1 - x for x in self)
        return Interval(value, low, high)

    def as_json(self) -> dict[str, float | str | None]:
        """``value``, ``low`` and ``high``, each None where it is not known.

        Without limits ``no_interval`` says why there are none.
        """
        told: dict[str, float | str | None] = {
            name: x if isfinite(x) else None for name, x in self._asdict().items()
        }
        if not self.known:
            told["no_interval"] = NOT_COUNTED if isnan(self.value) else NO_RUNS
        return told

    def text(self, form: str = ".3g", unit: str = "") -> str:
        """As a table shows it: the estimate with its limits, or without any and a word why."""
        if isnan(self.value):
            return "-"
        shown = f"{self.value:{form}}{unit}"
        if not self.known:
            return f"{shown} (no interval)"
        return f"{shown} [{self.low:{form}}, {self.high:{form}}]"


NOTHING: Final = Interval(nan)
"""Of no trial."""


def _checked(confidence: float) -> float:
    if not 0 < confidence < 1:
        raise ValueError(f"confidence: got {confidence}, expected between 0 and 1")
    return confidence


def wilson(successes: float, trials: int, confidence: float = CONFIDENCE) -> Interval:
    """Wilson's score interval of a proportion (Wilson 1927), for independent trials.

    Raises
    ------
    ValueError
        When there is no trial, or more successes than trials.
    """
    if not 0 <= successes <= trials or trials < 1:
        raise ValueError(f"got {successes} successes of {trials} trials, expected 0 to trials >= 1")
    z = NormalDist().inv_cdf(0.5 + _checked(confidence) / 2)
    p = successes / trials
    scale = 1 + z * z / trials
    centre = (p + z * z / (2 * trials)) / scale
    half = z * sqrt((p * (1 - p) + z * z / (4 * trials)) / trials) / scale
    low = 0.0 if successes == 0 else centre - half
    high = 1.0 if successes == trials else centre + half
    return Interval(p, low, high)


def clopper_pearson(k: int, n: int, alpha: float) -> tuple[float, float]:
    """One-sided bounds on a probability, from ``k`` successes in ``n`` trials.

    Parameters
    ----------
    k, n : int
        Successes, and independent trials, looked at once.
    alpha : float
        Probability that a bound does not hold, for each of the two; 1e-6 is usual here.

    Returns
    -------
    tuple of float
        Lower and upper bound (Clopper and Pearson 1934).
    """
    from scipy.special import betaincinv

    lower = 0.0 if k == 0 else float(betaincinv(k, n - k + 1, alpha))
    upper = 1.0 if k == n else float(betaincinv(k + 1, n - k, 1 - alpha))
    return lower, upper


def normal(value: float, error: float, confidence: float = CONFIDENCE) -> Interval:
    """The interval of an estimate that is about normal, with its standard error ``error``."""
    half = NormalDist().inv_cdf(0.5 + _checked(confidence) / 2) * error
    return Interval(value, value - half, value + half)


# --- over runs ------------------------------------------------------------------------------------


def _tail(runs: int, confidence: float) -> float:
    """Share of the resamples beyond either limit.

    The percentile interval of few runs is too narrow, by what a normal quantile lacks of Student's
    and by the variance's divisor; its tails are taken so much smaller (Hesterberg 2015, "expanded
    percentile").
    """
    from scipy.special import stdtrit

    t = float(stdtrit(runs - 1, 0.5 + confidence / 2))
    return NormalDist().cdf(-t * sqrt(runs / (runs - 1)))


def mean_over_runs(
    histogram: Mapping[int, int],
    *,
    confidence: float = CONFIDENCE,
    resamples: int = RESAMPLES,
    seed: int = SEED,
) -> Interval:
    """Mean of a count over runs, with its bootstrap interval (Efron 1979) over runs.

    Fewer than :data:`FEWEST_RUNS` runs have no interval, nor have runs that all had the same count:
    resampling them says nothing.

    Parameters
    ----------
    histogram : mapping of int to int
        How many runs had each value of the count: resampling runs is one multinomial draw.
    confidence : float
    resamples : int
    seed : int
        Of the resampling: the same histogram gives the same interval.

    Raises
    ------
    ValueError
        When there is no run.
    """
    import numpy as np

    _checked(confidence)
    values = np.array(sorted(histogram), dtype=float)
    counts = np.array([histogram[v] for v in sorted(histogram)], dtype=np.int64)
    runs = int(counts.sum())
    if runs < 1 or (counts < 0).any():
        raise ValueError(f"histogram: got {dict(histogram)}, expected at least one run")
    value = float((values * counts).sum() / runs)
    if runs < FEWEST_RUNS or (counts > 0).sum() < 2:
        return Interval(value)
    drawn = np.random.default_rng(seed).multinomial(runs, counts / runs, size=resamples)
    means = (drawn * values).sum(axis=1) / runs
    tail = _tail(runs, confidence)
    low, high = np.quantile(means, [tail, 1 - tail])
    return Interval(value, float(low), float(high))


def share_over_runs(
    runs: Iterable[tuple[float, int]],
    *,
    confidence: float = CONFIDENCE,
    resamples: int = RESAMPLES,
    seed: int = SEED,
) -> Interval:
    """Share of successes in the trials of all runs, with its interval over runs.

    Runs are resampled whole. Where each had one trial, or all had none or nothing but successes, it
    is Wilson's interval with runs as the trials. Fewer than :data:`FEWEST_RUNS` runs that had any
    trial have no interval.

    Few runs that happen to be alike resample to a narrow interval, and runs that are all alike to
    one of no width. So where runs are fewer than :data:`FEW_RUNS`, or all alike, the interval is
    never narrower than Wilson's over all their trials.

    Measured coverage of the 95 % interval, 1000 draws of each kind (before: without that rule):

    =============================================  ======  =======  =======  =======
    runs and the share of each                     5 runs  10 runs  20 runs  40 runs
    =============================================  ======  =======  =======  =======
    0.305 of 10 to the nearest trial, in a rhythm  1.000   1.000    0.999    1.000
    the same, before                               0.219   0.395    0.649    0.861
    0.305 of 10 independent trials                 0.972   0.965    0.961    0.943
    the same, before                               0.865   0.933    0.961    0.943
    0.3 of 200 independent trials                  0.973   0.966    0.943    0.956
    of 100 trials, beta(6, 4) over runs            0.915   0.945    0.941    0.945
    of 100 trials, beta(0.08, 3.92) over runs      0.825   0.772    0.819    0.853
    =============================================  ======  =======  =======  =======

    The last row is a warning: where most runs have next to nothing and few have much, the interval
    is too narrow, before as after.

    Parameters
    ----------
    runs : iterable of (float, int)
        Successes and trials of each run.
    confidence : float
    resamples : int
    seed : int
    """
    import numpy as np

    _checked(confidence)
    alike = Counter((right, of) for right, of in runs if of)
    count = alike.total()
    if not count:
        return NOTHING
    kinds = sorted(alike)
    right, of = (np.array(column, dtype=float) for column in zip(*kinds, strict=True))
    counts = np.array([alike[kind] for kind in kinds])
    value = float((counts @ right) / (counts @ of))
    if count < FEWEST_RUNS:
        return Interval(value)
    if (of == 1).all() or value in (0.0, 1.0):
        return wilson(float(counts @ (right / of)), count, confidence)
    draw = np.random.default_rng(seed)
    shares = np.empty(resamples)
    most = max(1, 2_000_000 // len(kinds))  # drawn at once
    for first in range(0, resamples, most):
        size = min(most, resamples - first)
        weights = draw.multinomial(count, counts / count, size=size)
        shares[first : first + size] = (weights @ right) / (weights @ of)
    tail = _tail(count, confidence)
    low, high = (float(limit) for limit in np.quantile(shares, [tail, 1 - tail]))
    if count < FEW_RUNS or (right * of[0] == right[0] * of).all():
        apart = wilson(float(counts @ right), int(counts @ of), confidence)
        low, high = min(low, apart.low), max(high, apart.high)
    return Interval(value, low, high)


def normal_mean(
    total: float, squares: float, runs: int, confidence: float = CONFIDENCE
) -> Interval:
    """Mean over runs from the sums of values and of squares, with Student's interval.

    Fewer than :data:`FEWEST_RUNS` runs have no interval.

    Raises
    ------
    ValueError
        When there is no run.
    """
    if runs < 1:
        raise ValueError(f"runs: got {runs}, expected at least 1")
    _checked(confidence)
    mean = total / runs
    if runs < FEWEST_RUNS:
        return Interval(mean)
    from scipy.special import stdtrit

    variance = max(0.0, (squares - runs * mean * mean) / (runs - 1))
    half = float(stdtrit(runs - 1, 0.5 + confidence / 2)) * sqrt(variance / runs)
    return Interval(mean, mean - half, mean + half)


# --- looked at again and again --------------------------------------------------------------------


def log_evidence(successes: float, trials: int, p: float) -> float:
    """Natural logarithm of the evidence that a probability is not ``p``.

    The evidence is the likelihood of what was seen, averaged over all probabilities, over that
    under ``p``. Under ``p`` it is a martingale that starts at 1, so with probability 1 - alpha it
    never reaches 1 / alpha, however often one looks (Ville 1939; Robbins 1970). Where each trial's
    probability given those before is ``p`` at most, the same holds of its looks at which the share
    is above ``p``: the successes are then fewer than those of trials under ``p``.
    """
    failures = trials - successes
    evidence = lgamma(successes + 1) + lgamma(failures + 1) - lgamma(trials + 2)
    for count, chance in ((successes, p), (failures, 1 - p)):
        if count:
            evidence -= count * log(chance) if chance > 0 else -inf
    return evidence


def confidence_sequence(successes: float, trials: int, confidence: float = CONFIDENCE) -> Interval:
    """Limits of a probability that hold at every look together, however often one looks.

    The probabilities that :func:`log_evidence` does not speak against. A trial may also count as a
    success in part, from 0 to 1: the evidence is then smaller, and the limits still hold.

    Parameters
    ----------
    successes : float
    trials : int
        With none the limits are 0 and 1, and the value is NaN.
    confidence : float
        Probability that the limits hold at all looks.

    Raises
    ------
    ValueError
        When there are more successes than trials.
    """
    return sequence_limits(successes, trials, -log(1 - _checked(confidence)))


def sequence_limits(successes: float, trials: int, most: float) -> Interval:
    """The probabilities against which the evidence is less than ``most``, a natural logarithm.

    See :func:`confidence_sequence`, whose ``most`` is -ln(1 - confidence).

    Raises
    ------
    ValueError
        When there are more successes than trials.
    """
    if not 0 <= successes <= trials:
        raise ValueError(f"got {successes} successes of {trials} trials, expected 0 to trials")
    if not trials:
        return Interval(nan, 0.0, 1.0)
    share = successes / trials

    def limit(end: float) -> float:
        """Where the evidence reaches ``most``, between the share and an end of [0, 1]."""
        if log_evidence(successes, trials, end) < most:
            return end
        inside, outside = share, end
        for _ in range(60):
            middle = (inside + outside) / 2
            if log_evidence(successes, trials, middle) < most:
                inside = middle
            else:
                outside = middle
        return outside

    return Interval(share, limit(0.0), limit(1.0))


def better_than(chance: float, successes: float, trials: int, alpha: float) -> bool:
    """Whether somebody is shown to succeed more often than by ``chance``.

    Where Eve does not, this is ever true with probability ``alpha`` at most, however often one
    looks.
    """
    if successes <= chance * trials:
        return False
    return log_evidence(successes, trials, chance) >= -log(alpha)


# --- what guessing leaves -------------------------------------------------------------------------


MISSTATED: Final = 0.04
"""Of messages that a tap is sure of, the share that may be others: the measured share's upper limit
(``docs/data``; a test holds it)."""


def stated_left(bits: float, most: float) -> Interval:
    """Bits that one leaves who says herself how many, with limits.

    Eve's account is right but for a share :data:`MISSTATED` of messages; of those all may be left.
    Nothing says that a stronger one would not leave less: the lower limit is 0.

    Parameters
    ----------
    bits : float
        By Eve's account: the entropy of the message, given all that Eve heard.
    most : float
        Bits that there are.
    """
    told, q = min(bits, most), MISSTATED
    which = -q * log2(q) - (1 - q) * log2(1 - q)
    return Interval(told, 0.0, min(most, (1 - q) * told + q * most + which))


def bits_left(keys: int, size: int, guessed: Interval) -> Interval:
    """Bits that one leaves of ``keys`` symbols whom Eve guesses right with that probability.

    -log2 P_g each, with P_g never below 1 / size. The upper limit comes of the lower one of P_g:
    whoever is not shown to be better than chance leaves all that there may be.

    Parameters
    ----------
    keys : int
    size : int
        M.
    guessed : Interval
        P_g per symbol, with limits.
    """

    def left(probability: float) -> float:
        if isnan(probability):
            return nan
        return keys * abs(log2(min(1.0, max(probability, 1.0 / size))))

    return Interval(left(guessed.value), left(guessed.high), left(guessed.low))
