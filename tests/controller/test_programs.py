"""Programs of the general route: several inputs and states, and its solver."""

from pathlib import Path
from typing import Any

import numpy as np
import osqp
import pytest
from scipy.sparse import csc_matrix

import controller_service.laws.programs as programs_module
from controller_service.laws.base import CandidateLaw
from controller_service.laws.errors import ProgramError
from controller_service.laws.programs import General, Quadratic, solve_daqp
from controller_service.laws.registry import make_law
from controller_service.sets.design import Design, SynthesisError, synthesise
from protocol.scenario import Cost, Scenario
from runtime.scenario_file import load_scenario

SCENARIOS = Path(__file__).resolve().parents[2] / "runtime" / "scenarios"
TOP = np.array([6.0, 6.0, 1.7, 1.3])


@pytest.fixture(scope="module")
def tank() -> Scenario:
    return load_scenario(SCENARIOS / "quadruple-tank.toml")


@pytest.fixture(scope="module")
def design(tank: Scenario) -> Design:
    return synthesise(tank)


@pytest.fixture(scope="module")
def law(tank: Scenario, design: Design) -> CandidateLaw:
    return make_law(tank, design)


def by_osqp(P: np.ndarray, f: np.ndarray, G: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Minimise 1/2 u' P u + f' u subject to G u <= b by OSQP, at 1e-9 and polished."""
    free = np.linalg.solve(P, -f)
    if (G @ free <= b).all():
        return free  # with no active row OSQP's polishing prints to standard output
    solver = osqp.OSQP()
    solver.setup(
        P=csc_matrix(np.triu(P)),
        q=f,
        A=csc_matrix(G),
        l=np.full(len(b), -np.inf),
        u=b,
        eps_abs=1e-9,
        eps_rel=1e-9,
        max_iter=20000,
        polishing=True,
        verbose=False,
    )
    return np.array(solver.solve(raise_error=False).x)


@pytest.mark.slow
def test_daqp_and_osqp_agree(law: CandidateLaw, monkeypatch: Any) -> None:
    X = np.random.default_rng(2).uniform(-0.99, 0.99, (40, 4)) * TOP
    index = law.indices(X)
    by_daqp = law.candidates_many(X, index)
    monkeypatch.setattr(programs_module, "solve_daqp", by_osqp)
    assert np.abs(by_daqp - law.candidates_many(X, index)).max() < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("answer", [np.array([3.0 + 1e-8, 0.0]), None])
def test_a_wrong_answer_is_refused(
    law: CandidateLaw, monkeypatch: Any, answer: np.ndarray | None
) -> None:
    monkeypatch.setattr(programs_module, "solve_daqp", lambda *_: answer)
    with pytest.raises(ProgramError, match="no answer that satisfies the constraints"):
        law.candidates([3.0, -3.0, 0.5, -0.5])


def test_the_solver_meets_the_optimality_conditions() -> None:
    rng = np.random.default_rng(3)
    for _ in range(60):
        L = rng.normal(size=(2, 2))
        P, f = L @ L.T + 0.1 * np.eye(2), 5 * rng.normal(size=2)
        G = np.vstack([rng.normal(size=(12, 2)), np.eye(2), -np.eye(2)])
        b = np.concatenate([rng.uniform(0.2, 1, 12), np.ones(4)])
        u = solve_daqp(P, f, G, b)
        assert u is not None
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


def test_the_solver_admits_that_there_is_no_answer() -> None:
    G, b = np.array([[1.0, 0.0], [-1.0, 0.0]]), np.array([-1.0, -1.0])
    assert solve_daqp(np.eye(2), np.array([0.3, -0.2]), G, b) is None


def test_the_general_route_gives_what_the_planar_one_gives() -> None:
    scenario = load_scenario(SCENARIOS / "sustained.toml")
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


def three_states(**control: Any) -> Scenario:
    """Three integrators in a chain with one input and a box of states."""
    return Scenario.model_validate(
        {
            "name": "chain",
            "plant": {
                "A": [[0.9, 0.2, 0.0], [0.0, 0.8, 0.2], [0.0, 0.0, 0.7]],
                "B": [[0.0], [0.1], [0.5]],
                "period_s": 0.1,
                "initial_state": [0.5, 0.0, 0.0],
                "disturbance": {"half_widths": [0.01, 0.01, 0.01]},
            },
            "defender": {"disturbance": {"half_widths": [0.02, 0.02, 0.02]}},
            "control": {
                "horizon": 8,
                "inputs": {"half_widths": [1.0]},
                "states": {"half_widths": [3.0, 3.0, 3.0]},
                "gain": [[-0.05, -0.02, -0.01]],
                **control,
            },
            "secrecy": {"alpha": 4.0},
        }
    )


def test_plants_beyond_the_route_are_refused() -> None:
    data = three_states().model_dump(exclude_none=True)
    data["plant"]["B"] = [[0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]]
    data["control"]["inputs"] = {"half_widths": [1.0, 1.0, 1.0]}
    data["control"]["gain"] = [[-0.1, 0.0, 0.0]] * 3
    with pytest.raises(SynthesisError, match="3 states and 3 inputs"):
        synthesise(Scenario.model_validate(data))


def test_the_expanded_cost_is_the_cost() -> None:
    rng = np.random.default_rng(6)
    A, B = rng.normal(size=(3, 3)), rng.normal(size=(3, 2))
    cost = Cost(next_state=(1.0, 2.0, 0.0), input=(0.5, 3.0))
    q = Quadratic.of(A, B, cost)
    x = rng.normal(size=3)

    def value(u: np.ndarray) -> float:
        c = A @ x + B @ u
        return float(c @ (np.array([1.0, 2.0, 0.0]) * c) + u @ (np.array([0.5, 3.0]) * u))

    u = rng.normal(size=2)
    expanded = 0.5 * u @ q.P @ u + (q.F @ x) @ u
    assert value(u) - value(np.zeros(2)) == pytest.approx(expanded)
