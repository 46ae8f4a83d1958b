"""The shipped plants that are no matrices: every tested step agrees, and nothing leaves D_c."""

import numpy as np
import pytest

from wyner.api import design, run

RATES = {
    "pendulum": 10.0,
    "unicycle": 10.0,
    "motor": 5.0,
    "nonlinear-quadruple-tank": 0.2,
    "gymnasium-pendulum": 20.0,
}
"""Bits a second: 2 bits every second step, the motor 1."""


@pytest.mark.parametrize("name", RATES)
def test_every_tested_step_agrees(name: str) -> None:
    if name.startswith("gymnasium"):
        pytest.importorskip("gymnasium")
    system = design(name)
    runs = run(system, steps=200, runs=2, seed=1, message=b"plant")
    applied = np.take_along_axis(runs.gauges, runs.coin[:, :, None].astype(np.intp), axis=2)
    assert applied.max() <= 1.0
    assert runs.gauges.max() <= system.scenario.secrecy.alpha
    tested = (runs.message_symbol < 0).sum()
    assert (runs.key >= 0).sum() == tested
    assert runs.rate.value == pytest.approx(RATES[name])
    assert (runs.key[runs.key >= 0] == runs.coin[runs.key >= 0]).all()


def test_the_tank_stands_still_at_its_operating_point() -> None:
    from runtime.scenarios.plants import quadruple_tank

    point = design("nonlinear-quadruple-tank").scenario.plant.operating_point
    assert point is not None
    assert point.state is not None
    assert np.abs(quadruple_tank(0.0, point.state, point.input)).max() < 1e-12


@pytest.mark.parametrize("name", ["pendulum", "unicycle", "nonlinear-quadruple-tank"])
def test_the_model_is_the_plants_linearisation(name: str) -> None:
    """A and B by differences of the simulated step; the tank's within its Runge-Kutta error."""
    from plant_service.adapters.registry import open_plant

    s = design(name).scenario

    def stepped(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        plant = open_plant(s)
        plant.start(None)
        plant.resume(tuple(x.tolist()), 0)
        plant.apply(tuple(u.tolist()))
        return np.array(plant.sample())

    e, n, m = 1e-5, s.n, s.m
    for j in range(n):
        d = e * np.eye(n)[j]
        column = (stepped(d, np.zeros(m)) - stepped(-d, np.zeros(m))) / (2 * e)
        assert column == pytest.approx(np.array(s.A)[:, j], abs=2e-6)
    for j in range(m):
        d = e * np.eye(m)[j]
        column = (stepped(np.zeros(n), d) - stepped(np.zeros(n), -d)) / (2 * e)
        assert column == pytest.approx(np.array(s.B)[:, j], abs=2e-6)


def test_the_khepera_reaches_each_velocity_that_is_offered() -> None:
    """Wheels at 250 of 1200 (0.813 m/s), 0.1047 m apart, the point 0.1 m before the axle."""
    wheel = 250 / 1200 * 0.813
    runs = run(design("khepera"), steps=300, runs=4, seed=1)
    assert (runs.key == runs.coin).all()
    heading = np.linspace(0, 2 * np.pi, 73)
    ahead, aside = np.cos(heading), np.sin(heading)
    u = runs.candidates.reshape(-1, 2)
    forward = np.outer(u[:, 0], ahead) + np.outer(u[:, 1], aside)
    turning = (np.outer(u[:, 1], ahead) - np.outer(u[:, 0], aside)) / 0.1
    assert (np.abs(forward) + 0.1047 / 2 * np.abs(turning)).max() <= wheel
