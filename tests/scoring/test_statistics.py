"""Intervals: known answers, and that they cover what they say."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wyner.scoring.statistics import Interval, bootstrap_mean, normal_mean, wilson


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [
        # Newcombe 1998, table I, method 3.
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilson_has_the_printed_limits(
    successes: int, trials: int, low: float, high: float
) -> None:
    interval = wilson(successes, trials)
    assert interval.low == pytest.approx(low, abs=5e-5)
    assert interval.high == pytest.approx(high, abs=5e-5)


@given(st.integers(1, 500).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilson_lies_in_the_unit_interval_around_its_estimate_and_mirrors(
    case: tuple[int, int],
) -> None:
    k, n = case
    interval = wilson(k, n)
    assert 0 <= interval.low <= interval.value <= interval.high <= 1
    other = wilson(n - k, n)
    assert other.low == pytest.approx(1 - interval.high, abs=1e-12)


def test_wilson_covers_at_its_confidence() -> None:
    for p in (0.02, 0.3, 0.9):
        drawn = np.random.default_rng(1).binomial(60, p, size=4000)
        inside = [wilson(int(k), 60).low <= p <= wilson(int(k), 60).high for k in drawn]
        assert 0.92 <= np.mean(inside) <= 0.985, p


def test_the_bootstrap_is_near_the_normal_interval_and_the_same_twice() -> None:
    rng = np.random.default_rng(2)
    values = rng.poisson(7.0, size=2000)
    histogram = {int(v): int((values == v).sum()) for v in np.unique(values)}
    interval = bootstrap_mean(histogram)
    assert interval == bootstrap_mean(dict(reversed(histogram.items())))
    assert interval != bootstrap_mean(histogram, seed=1)
    assert interval.value == pytest.approx(values.mean())
    normal = normal_mean(float(values.sum()), float((values**2).sum()), len(values))
    assert interval.low == pytest.approx(normal.low, abs=0.01)
    assert interval.high == pytest.approx(normal.high, abs=0.01)


def test_the_bootstrap_covers_at_its_confidence() -> None:
    rng = np.random.default_rng(3)
    inside = 0
    for _ in range(400):
        values = rng.binomial(5, 0.3, size=60)
        histogram = {int(v): int((values == v).sum()) for v in np.unique(values)}
        interval = bootstrap_mean(histogram, resamples=500)
        inside += interval.low <= 1.5 <= interval.high
    assert 0.90 <= inside / 400 <= 0.98


def test_runs_that_are_all_equal_leave_no_width_and_zero_has_no_relative_one() -> None:
    assert bootstrap_mean({4: 10}) == (4.0, 4.0, 4.0)
    assert bootstrap_mean({0: 10}).relative_width == float("inf")
    assert Interval(2.0, 1.0, 3.0).scaled(2.0) == (4.0, 2.0, 6.0)
    assert Interval(2.0, 1.0, 3.0).relative_width == 1.0


def test_normal_mean_of_known_values() -> None:
    interval = normal_mean(10.0, 30.0, 4)  # 1, 2, 3, 4: variance 5/3
    assert interval.value == 2.5
    assert interval.width == pytest.approx(2 * 1.959963985 * (5 / 3 / 4) ** 0.5)


def test_wrong_arguments_are_told() -> None:
    with pytest.raises(ValueError, match="got 3 successes of 2 trials"):
        wilson(3, 2)
    with pytest.raises(ValueError, match="at least one run"):
        bootstrap_mean({})
    with pytest.raises(ValueError, match="at least 2"):
        normal_mean(1.0, 1.0, 1)
    with pytest.raises(ValueError, match="confidence: got 1"):
        bootstrap_mean({1: 1}, confidence=1.0)
    with pytest.raises(ValueError, match="confidence: got 0"):
        wilson(1, 2, confidence=0.0)
