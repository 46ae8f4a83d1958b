"""The price of dither against a simulated loop."""

import numpy as np
import pytest

from controller_service.sets.terminal import feedback_gain
from runtime.scenario_file import scenario_of
from studies.capacity.price import added, dither_price


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
