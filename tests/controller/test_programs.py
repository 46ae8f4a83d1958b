"""Programs of the general route: several inputs and states, and its solvers."""

from typing import Any

import numpy as np
import pytest

import controller_service.laws.programs as programs_module
from controller_service.laws.base import CandidateLaw
from controller_service.laws.errors import ProgramError
from controller_service.laws.programs import General, solve_daqp, solve_osqp
from controller_service.laws.registry import make_law
from controller_service.sets.design import Design, SynthesisError, synthesise
from protocol.scenario import Scenario
from runtime.scenario_file import scenario_of
from tests.controller.test_plants import plant

TOP = np.array([6.0, 6.0, 1.7, 1.3])


@pytest.fixture(scope="module")
def tank() -> Scenario:
    return scenario_of("quadruple-tank")


@pytest.fixture(scope="module")
def design(tank: Scenario) -> Design:
    return synthesise(tank)


@pytest.fixture(scope="module")
def law(tank: Scenario, design: Design) -> CandidateLaw:
    return make_law(tank, design)


@pytest.mark.slow
def test_daqp_and_osqp_agree(law: CandidateLaw, design: Design, monkeypatch: Any) -> None:
    X = np.random.default_rng(2).uniform(-0.99, 0.99, (40, 4)) * TOP
    index = law.indices(X)
    by_daqp = law.candidates_many(X, index)
    monkeypatch.setattr(programs_module, "solve_daqp", lambda *_: None)
    by_osqp = law.candidates_many(X, index)
    assert np.abs(by_daqp - by_osqp).max() < 1e-6


@pytest.mark.slow
def test_a_wrong_answer_is_replaced_or_refused(law: CandidateLaw, monkeypatch: Any) -> None:
    x = [3.0, -3.0, 0.5, -0.5]
    right = law.candidates(x)

    def off(*_: object) -> np.ndarray:
        return np.array([3.0 + 1e-8, 0.0])

    monkeypatch.setattr(programs_module, "solve_daqp", off)
    assert np.abs(np.array(law.candidates(x)) - np.array(right)).max() < 1e-6
    monkeypatch.setattr(programs_module, "solve_osqp", off)
    with pytest.raises(ProgramError, match="no solver's answer"):
        law.candidates(x)


@pytest.mark.parametrize("solve", [solve_daqp, solve_osqp])
def test_solvers_meet_the_optimality_conditions(solve: Any) -> None:
    rng = np.random.default_rng(3)
    for _ in range(60):
        L = rng.normal(size=(2, 2))
        P, f = L @ L.T + 0.1 * np.eye(2), 5 * rng.normal(size=2)
        G = np.vstack([rng.normal(size=(12, 2)), np.eye(2), -np.eye(2)])
        b = np.concatenate([rng.uniform(0.2, 1, 12), np.ones(4)])
        u = solve(P, f, G, b)
        assert (G @ u <= b + 1e-7).all()
        # The gradient is a combination of active rows with non-positive factors.
        active = G[G @ u > b - 1e-6]
        gradient = P @ u + f
        if not len(active):
            assert np.abs(gradient).max() < 1e-6
            continue
        from scipy.optimize import nnls

        _, left = nnls(active.T, -gradient)
        assert left < 1e-5


@pytest.mark.parametrize("solve", [solve_daqp, solve_osqp])
def test_solvers_admit_that_there_is_no_answer(solve: Any) -> None:
    G, b = np.array([[1.0, 0.0], [-1.0, 0.0]]), np.array([-1.0, -1.0])
    assert solve(np.eye(2), np.array([0.3, -0.2]), G, b) is None


def test_the_general_route_gives_what_the_planar_one_gives() -> None:
    scenario = scenario_of("sustained")
    control = scenario.control.model_copy(update={"horizon": 40})
    scenario = scenario.model_copy(update={"control": control})
    design = synthesise(scenario)
    planar = make_law(scenario, design)
    general = General(design, scenario.control.inputs, scenario.control.costs)
    X = np.random.default_rng(4).normal(size=(3000, 2)) * 2
    index = planar.indices(X)
    assert np.array_equal(general.indices(X), index)
    left, right = planar.candidates_many(X, index), general.candidates_many(X, index)
    assert np.abs(left - right).max() < 1e-10


def test_plants_beyond_the_route_are_refused() -> None:
    data = plant(3, 2, "stable", 5).model_dump(exclude_none=True)
    data["plant"]["B"] = np.eye(3).tolist()
    data["control"]["inputs"] = {"half_widths": [1.0] * 3}
    data["control"]["regulator"]["input"] = [1.0] * 3
    with pytest.raises(SynthesisError, match="3 states and 3 inputs"):
        synthesise(Scenario.model_validate(data))
