"""The capacity table against the theorems, and its price against a simulated loop."""

import math

import numpy as np
import pytest

from controller_service.sets.terminal import feedback_gain
from runtime.scenario_file import scenario_of
from wyner.capacity.table import added, capacity, dither_price


def test_certain_sizes_of_the_papers_plant() -> None:
    table = capacity(scenario_of("packed"), (1.5, 3, 3.01, 5.01, 7.01, 8, 9.01, 40))
    assert [row.certain for row in table.rows] == [1, 1, 2, 3, 4, 4, 5, 20]
    # At 40 control's ceiling, not alpha, is the limit.
    assert [row.held for row in table.rows] == [1, 1, 2, 3, 4, 4, 5, 12]
    assert table.sigma == pytest.approx(2 * 0.12 / 0.4877)


@pytest.mark.parametrize(
    "name", ["packed", "packed-double-integrator", "packed-quadruple-tank", "packed-batch-reactor"]
)
def test_bounds_are_in_order(name: str) -> None:
    scenario = scenario_of(name)
    for row in capacity(scenario, (1.2, 2, 3.01, 4, 5.5, 8, 10)).rows:
        assert row.held <= row.certain <= row.bound
        assert row.bits <= row.volume + 1e-9
        assert math.log2(row.bound) <= row.volume + 1e-9
        if row.erasures is not None:
            # Long alphabets pass the certain one, and stay below the volume bound.
            assert math.log2(row.certain) <= row.erasures <= row.volume


def test_bets_never_beat_what_is_left_below_certainty() -> None:
    for row in capacity(scenario_of("packed"), (2, 3, 3.01, 5.01, 8)).rows:
        assert row.bet is not None
        assert row.bits - 1e-9 <= row.bet.bits <= math.log2(row.held + 2)


def test_price_is_that_of_a_simulated_loop() -> None:
    scenario = scenario_of("packed")
    A, B = np.array(scenario.A), np.array(scenario.B)
    K = feedback_gain(scenario)
    price = dither_price(A, B, K)
    assert price.state[0] == pytest.approx(0.2623, abs=1e-3)
    assert price.input[0] == pytest.approx(2.055, abs=2e-3)
    rng = np.random.default_rng(4)
    x, states, inputs = np.zeros((400, 2)), [], []
    for k in range(600):
        u = x @ K.T + rng.choice([-0.5, 0.5], (400, 1))
        x = x @ A.T + u @ B.T
        if k > 100:
            states.append((x * x).sum(axis=1).mean())
            inputs.append((u * u).mean())
    assert np.mean(states) == pytest.approx(0.25 * price.state[0], rel=0.02)
    assert np.mean(inputs) == pytest.approx(0.25 * price.input[0], rel=0.02)


def test_a_further_bit_costs_four_times_the_dither() -> None:
    table = capacity(scenario_of("packed"), (3.01, 7.01, 15.01))
    prices = [row.state_price for row in table.rows]
    assert prices[0] is not None
    assert [row.held for row in table.rows] == [2, 4, 8]
    assert prices == pytest.approx([prices[0], 5 * prices[0], 21 * prices[0]], rel=1e-6)


def test_price_of_two_inputs_counts_their_covariance() -> None:
    scenario = scenario_of("packed-quadruple-tank")
    A, B, K = np.array(scenario.A), np.array(scenario.B), feedback_gain(scenario)
    p = np.array([0.3, -0.2])
    x2, u2 = added(A, B, K, np.outer(p, p))
    one = dither_price(A, B, K)
    cross = added(A, B, K, np.array([[0.0, 0.5], [0.5, 0.0]]))
    assert x2 == pytest.approx(
        p[0] ** 2 * one.state[0] + p[1] ** 2 * one.state[1] + 2 * p[0] * p[1] * cross[0]
    )
    assert u2 == pytest.approx(
        p[0] ** 2 * one.input[0] + p[1] ** 2 * one.input[1] + 2 * p[0] * p[1] * cross[1]
    )
