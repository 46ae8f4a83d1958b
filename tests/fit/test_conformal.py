"""Certificates: their formulas, and that they hold as often as they say."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wyner.fit.conformal import CONFIDENCE, conformal_scale, rank, violation_bound


@pytest.mark.parametrize(("violation", "sessions"), [(0.067, 100), (0.01, 688), (0.001, 6905)])
def test_sessions_without_an_exit(violation: float, sessions: int) -> None:
    assert violation_bound(sessions, 0) <= violation
    assert violation_bound(sessions - 1, 0) > violation


@given(st.integers(1, 400), st.data())
def test_the_bound_is_where_the_binomial_tail_is_the_risk(
    sessions: int, data: st.DataObject
) -> None:
    exceeded = data.draw(st.integers(0, sessions - 1))
    p = violation_bound(sessions, exceeded)
    tail = sum(
        math.comb(sessions, i) * p**i * (1 - p) ** (sessions - i) for i in range(exceeded + 1)
    )
    assert tail == pytest.approx(1 - CONFIDENCE, rel=1e-6, abs=1e-12)
    assert exceeded / sessions <= p


def test_all_exceeded_bounds_nothing() -> None:
    assert violation_bound(5, 5) == 1.0


def training_conditional(sessions: int, k: int, violation: float) -> float:
    """How probable it is that *this* calibration promises too much.

    P[the k-th smallest of N scores is exceeded with probability > violation] is at most
    sum_{i=0}^{N-k} C(N, i) violation^i (1 - violation)^(N - i) (Vovk 2012, proposition 2a).
    """
    from scipy.stats import binom

    return float(binom.cdf(sessions - k, sessions, violation))


def test_coverage_is_what_split_conformal_promises() -> None:
    """Over 400 calibrations of 40 sessions (seed 1): mean and spread of coverage are a beta law's.

    The chance that the next score is below the k-th of N follows Beta(k, N - k + 1) exactly where
    scores are continuous: here uniform, so that the score is its own probability.
    """
    rng = np.random.default_rng(1)
    N, violation = 40, 0.1
    k = rank(N, violation)
    coverage = np.array([conformal_scale(rng.random(N).tolist(), violation) for _ in range(400)])
    mean = k / (N + 1)
    deviation = math.sqrt(k * (N - k + 1) / ((N + 1) ** 2 * (N + 2)))
    assert abs(coverage.mean() - mean) < 4 * deviation / math.sqrt(400)
    assert coverage.std() == pytest.approx(deviation, rel=0.15)
    short = float((coverage < 1 - violation).mean())
    bound = training_conditional(N, k, violation)
    assert short <= bound + 4 * math.sqrt(bound * (1 - bound) / 400)
