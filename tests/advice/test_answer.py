"""The three lines with which `wyner design` begins."""

import json
from typing import Any

import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov

from runtime.scenario_file import scenario_of
from runtime.shipped import SCENARIOS
from tests.support.bare_figures import bare_figures
from wyner.advice.answer import PlainLaw, ratio_of_means
from wyner.advice.design import design_report
from wyner.api import design
from wyner.simulate.engine import simulate_runs


def told(name: str) -> tuple[dict[str, Any], list[str]]:
    report = design_report(scenario_of(name), SCENARIOS)
    found = json.loads(json.dumps(report.figures))["answer"]
    assert list(bare_figures(found)) == []
    return found, str(report).partition("\n\n")[0].splitlines()


def test_a_law_that_talks_keeps_nothing_secret() -> None:
    found, lines = told("sustained")
    eve = found["eve"]
    assert eve["named"] == eve["agreed"] > 1000
    assert 0 < found["secret_bits_per_second_at_most"] < 0.01
    assert lines[0].startswith("secrecy: 2.3 [")
    assert f"Eve names {eve['named']} of {eve['agreed']} keys" in lines[0]
    assert "stays unseen with or without a key: control.law = 'sustained'" in lines[2]
    assert "does not keep its candidates apart" in found["spoofed_sensor"]["why_unseen"]


def test_a_packed_law_costs_several_times_the_plain_loop() -> None:
    found, lines = told("packed")
    beside = found["beside_plain_loop"]
    assert beside["cost"]["low"] > 2
    assert beside["input_rms"]["low"] > 4
    assert lines[1].startswith("cost: ")
    assert found["spoofed_sensor"]["mean_steps_until_seen"] == pytest.approx(4 / 3)
    assert "seen after 1.33 steps" in lines[2]


def test_a_law_that_falls_silent_has_nothing_secret() -> None:
    """Its few first keys were no rate, and the line named none."""
    found, lines = told("paper")
    assert found["secret_bits_per_second_at_most"] == 0.0 or found["eve"]["agreed"] > 0
    assert lines[0].startswith("secrecy: 0 ")


def test_the_plain_loop_costs_what_its_lyapunov_equation_says() -> None:
    """No input of it reaches its bound, so that the loop is linear."""
    system = design("packed")
    s = system.scenario
    runs = simulate_runs(
        s, PlainLaw(s, system.law.design), seed=1, runs=range(20), steps=4000, record=True
    )
    assert runs.x is not None
    K = np.array(system.law.design.K)
    loop = np.array(s.A) + np.array(s.B) @ K
    noise = np.diag(np.array(s.plant.disturbance.half_widths) ** 2 / 3)
    expected = solve_discrete_lyapunov(loop, noise)
    x = np.moveaxis(runs.x[500:], 1, 2).reshape(-1, s.n)
    assert x.T @ x / len(x) == pytest.approx(expected, rel=0.05)


def test_the_interval_of_a_ratio_covers_it() -> None:
    """In 90 to 99 of 100 draws of 20 runs each; the true ratio is 2."""
    draw = np.random.default_rng(5)
    covered = 0
    for _ in range(100):
        found = ratio_of_means(draw.gamma(20, 0.1, 20), draw.gamma(20, 0.05, 20))
        covered += found.low <= 2.0 <= found.high
    assert 85 <= covered <= 99
