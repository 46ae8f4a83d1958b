"""The rule of r failures among s tests: its rate of false alarms against a simulation."""

import math

import numpy as np
import pytest

from protocol.defence.alarm_rule import DAY_S, AlarmRule, alarm_rule, exit_probability


@pytest.mark.parametrize(("failures", "window", "q"), [(1, 1, 0.01), (2, 6, 0.02), (3, 9, 0.05)])
def test_the_rate_is_that_of_a_simulation(failures: int, window: int, q: float) -> None:
    steps = 2_000_000
    failed = np.random.default_rng(7).random(steps) < q
    recent = np.convolve(failed, np.ones(window), "full")[:steps]
    alarms = int((failed & (recent >= failures)).sum())
    rule = AlarmRule(failures, window)
    expected = rule.false_alarms(q, steps)
    # alarms come in bunches of up to a window
    assert abs(alarms - expected) < 4 * math.sqrt(window * expected)
    tests = by_hand = 0
    for k in range(5000):
        alarm, tests = rule.test(tests, failed=bool(failed[k]))
        by_hand += alarm
    assert by_hand == int((failed & (recent >= failures))[:5000].sum())


def test_a_step_of_the_promise() -> None:
    q = exit_probability(0.0098, 200)
    assert 1 - (1 - q) ** 200 == pytest.approx(0.0098, rel=1e-12)
    assert AlarmRule().false_alarms(q, DAY_S / 0.1) == pytest.approx(42.5, abs=0.1)
    assert AlarmRule(2, 6).false_alarms(q, DAY_S / 0.1) == pytest.approx(0.0105, abs=0.0002)


@pytest.mark.parametrize("rate", [50.0, 1.0, 0.01, 1e-4])
@pytest.mark.parametrize("candidates", [2, 4, 16])
def test_a_rule_keeps_to_its_rate_and_no_quicker_one_does(rate: float, candidates: int) -> None:
    rule = alarm_rule(0.0098, 200, 0.1, rate, candidates)
    q, day = exit_probability(0.0098, 200), DAY_S / 0.1
    assert rule.false_alarms(q, day) <= rate
    assert rule.window >= rule.failures / (1 - 1 / candidates) or rule == (1, 1)
    if rule.failures > 1:
        least = math.ceil((rule.failures - 1) / (1 - 1 / candidates))
        fewer = AlarmRule(rule.failures - 1, 1 if rule.failures == 2 else least)
        assert fewer.false_alarms(q, day) > rate


def test_a_fabricator_is_caught_within_the_window() -> None:
    """Under two of six at M = 4 she stays unseen for six steps with probability 0.0046."""
    rule = alarm_rule(0.0098, 200, 0.1, 0.02, 4)
    assert rule == (2, 6)
    draw = np.random.default_rng(7)
    failed = draw.random((100_000, 6)) >= 1 / 4
    unseen = (failed.cumsum(1).max(1) < rule.failures).mean()
    assert unseen == pytest.approx(6 * 0.75 * 0.25**5 + 0.25**6, abs=0.001)


def test_a_given_set_needs_one_failure() -> None:
    assert alarm_rule(0.0, 200, 0.1, 1e-9, 4) == AlarmRule()


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ((1.0, 200, 0.1, 1.0, 4), "session: got 1"),
        ((0.01, 0, 0.1, 1.0, 4), "steps: got 0"),
        ((0.01, 200, 0.0, 1.0, 4), "period_s: got 0"),
        ((0.01, 200, 0.1, 0.0, 4), "false_alarms_a_day: got 0"),
        ((0.01, 200, 0.1, 1.0, 1), "candidates: got 1"),
        ((0.99999999, 2, 0.1, 1e-9, 4), "which no rule of up to 2 tests"),
    ],
)
def test_what_cannot_be_is_one_line(
    arguments: tuple[float, int, float, float, int], named: str
) -> None:
    with pytest.raises(ValueError, match=named) as error:
        alarm_rule(*arguments)
    assert "\n" not in str(error.value)
