"""The law ``packed``: every candidate is admissible for ever, and every transition agrees."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from controller_service.laws.base import CandidateLaw
from controller_service.laws.registry import cached_design, make_law, synthesise
from controller_service.sets.alphabet import (
    Alphabet,
    line_offsets,
)
from controller_service.sets.design import Design, SynthesisError
from controller_service.sets.invariance import invariance
from controller_service.sets.packed_design import invariant_set, reduced
from controller_service.sets.separation import Separation
from controller_service.sets.terminal import set_corners
from protocol.convex import corners
from protocol.scenario import ConvexSet, Scenario, parse_scenario
from runtime.scenario_file import scenario_of
from tests.support.scenarios import changed
from wyner.cli.new import sampled

SHIPPED = (
    "packed",
    "packed-double-integrator",
    "packed-quadruple-tank",
    "packed-batch-reactor",
)


TWO_MASSES: list[list[float]] = [
    [0, 0, 1, 0],
    [0, 0, 0, 1],
    [-2, 1, -0.02, 0.01],
    [1, -2, 0.01, -0.02],
]


def shipped(name: str, *, candidates: int | None = None, alpha: float | None = None) -> Scenario:
    scenario = scenario_of(name)
    fields = {"candidates": candidates, "alpha": alpha}
    asked = {field: value for field, value in fields.items() if value is not None}
    secrecy = scenario.secrecy.model_copy(update=asked)
    return scenario.model_copy(update={"secrecy": secrecy})


def with_control(scenario: Scenario, **fields: Any) -> Scenario:
    return scenario.model_copy(update={"control": scenario.control.model_copy(update=fields)})


def system(scenario: Scenario) -> tuple[CandidateLaw, Design]:
    design = cached_design(scenario)
    return make_law(scenario, design), design


def adversary(scenario: Scenario, steps: int, *, runs: int = 200, seed: int = 1) -> None:
    """Corners of D_c and, half of the time, the outermost candidates; from 0 and from the corners
    of T_0 to T_5. Every candidate in U, the index falls, and x+ is within D_c of one centre alone
    and within alpha D_c of all.
    """
    law, design = system(scenario)
    rng = np.random.default_rng(seed)
    A, B = np.array(scenario.A), np.array(scenario.B)
    DV = set_corners(scenario.defender.disturbance)
    starts = np.concatenate([corners(*design.set(i)) for i in range(min(6, design.horizon))])
    X = np.zeros((runs, scenario.n))
    X[runs // 2 :] = rng.permutation(starts)[: runs - runs // 2][
        np.arange(runs - runs // 2) % min(len(starts), runs - runs // 2)
    ] * (1 - 1e-9)
    H, h = (np.array(a) for a in scenario.control.inputs.rows())
    G, g = (np.array(a) for a in scenario.defender.disturbance.rows())
    size, alpha = scenario.secrecy.candidates, scenario.secrecy.alpha
    index = law.indices(X)
    everyone = np.arange(runs)
    for k in range(steps // runs):
        candidates = law.candidates_many(X, index)
        assert candidates.shape == (runs, size, scenario.m)
        assert (candidates @ H.T <= h).all()
        chosen = rng.integers(0, size, runs)
        if k % 2:
            chosen = np.where(rng.random(runs) < 0.5, 0, size - 1)
        d = DV[rng.integers(0, len(DV), runs)]
        following = X @ A.T + candidates[everyone, chosen] @ B.T + d
        centres = (X @ A.T)[:, None] + candidates @ B.T
        gauges = ((following[:, None] - centres) @ G.T / g).max(axis=2)
        inside = gauges <= 1 + 1e-9
        assert (inside.sum(axis=1) == 1).all()
        assert inside[everyone, chosen].all()
        assert (gauges.argmin(axis=1) == chosen).all()  # nearest centre: what the tap reads
        assert (gauges <= alpha).all()
        X = following
        fallen = law.indices(X)
        assert (fallen <= np.maximum(index - 1, 0)).all()
        index = fallen


@pytest.mark.parametrize("name", SHIPPED)
def test_an_adversary_finds_no_violation(name: str) -> None:
    adversary(shipped(name), 40_000)


@pytest.mark.parametrize(("alpha", "size"), [(3.01, 2), (5.01, 3), (9.01, 5), (15.01, 8)])
def test_other_alphabets_of_the_papers_plant(alpha: float, size: int) -> None:
    adversary(shipped("packed", candidates=size, alpha=alpha), 20_000)


def test_the_papers_gain_serves_too() -> None:
    scenario = with_control(shipped("packed"), gain=((-13.27, -2.26),), regulator=None)
    design = cached_design(scenario)
    assert design.gain_given
    assert design.K.tolist() == [[-13.27, -2.26]]
    assert design.terminal.method == "rakovic"
    adversary(scenario, 20_000)


@pytest.mark.parametrize("width", [0.01, 1e-8])
def test_a_thin_disturbance_is_looked_up_as_it_is_scanned(width: float) -> None:
    """Corners of nearly parallel rows were out of order, and states held against other facets."""
    scenario = shipped("packed")
    box = ConvexSet(half_widths=(width, width))
    defender = scenario.defender.model_copy(update={"disturbance": box})
    law, design = system(scenario.model_copy(update={"defender": defender}))
    for i in range(1, 6):
        V = corners(*design.set(i))
        V = np.concatenate([V, 0.5 * (V + np.roll(V, 1, axis=0))])
        X = np.concatenate([V * (1 - 1e-9), V * (1 + 1e-6)])
        holds = [(h >= X @ H.T).all(axis=1) for H, h in design.T]
        assert law.indices(X).tolist() == np.array(holds).argmax(axis=0).tolist()


def test_what_keeps_the_terminal_set_is_checked() -> None:
    found = {name: invariance(shipped(name), cached_design(shipped(name))) for name in SHIPPED[:2]}
    assert found == {"packed": "gain", "packed-double-integrator": "control"}
    scenario, design = shipped("packed"), cached_design(shipped("packed"))
    T = ((design.T[0][0], design.T[0][1] * 0.5), *design.T[1:])
    assert invariance(scenario, replace(design, T=T)) is None


def test_a_slow_oscillation_is_held_by_a_regulator_that_decays() -> None:
    """Two masses between springs: no weights' regulator keeps a set, and the file states none."""
    A = sampled(TWO_MASSES, [[0.0], [0.0], [1.0], [0.0]], 0.05)
    base = shipped("packed").model_dump(exclude_none=True)
    half_widths = [0.01 * abs(row[0]) for row in A[1]]
    base["plant"].update(A=A[0], B=A[1], period_s=0.05, initial_state=[0.0] * 4)
    base["plant"]["disturbance"] = {"half_widths": half_widths}
    base["defender"] = {"disturbance": {"half_widths": half_widths}}
    base["control"].update(horizon=2, inputs={"half_widths": [1.0]})
    base["control"]["regulator"] = {"next_state": [1.0] * 4, "input": [1.0]}
    scenario = parse_scenario(base, "masses")
    design = cached_design(scenario)
    assert design.terminal.method == "modal"
    assert design.terminal.decay < 1
    adversary(scenario, 20_000)


def test_the_double_integrator_holds_four_candidates_and_no_more() -> None:
    """Control's ceiling is sharp: at five the recursion itself ends with no set."""
    scenario = shipped("packed-double-integrator", candidates=5, alpha=10)
    with pytest.raises(SynthesisError, match=r"secrecy.candidates: got 5, expected at most 4"):
        synthesise(scenario)
    sep = Separation.of(scenario.B, scenario.defender.disturbance)
    for number in (2, 3, 4):
        invariant_set(reduced(scenario, Alphabet(line_offsets(sep, number), 2.0)))
    with pytest.raises(SynthesisError, match=r"control.states: no state within them"):
        invariant_set(reduced(scenario, Alphabet(line_offsets(sep, 5), 2.0)))


def test_without_a_set_to_begin_with_the_bounds_are_asked_for() -> None:
    scenario = with_control(shipped("packed-double-integrator"), states=None)
    with pytest.raises(SynthesisError, match=r"control.states: got none, expected a compact set"):
        synthesise(scenario)


def test_a_bet_is_made_on_request() -> None:
    scenario = shipped("packed", candidates=2, alpha=2.68)
    secrecy = {"candidates": 2, "alpha": 2.68}
    bet = changed("packed", secrecy=secrecy, control={"alphabet": {"spacing": 1.834}})
    design = synthesise(bet)
    assert design.offsets is not None
    sep = Separation.of(scenario.B, scenario.defender.disturbance)
    assert np.ptp(design.offsets) == pytest.approx(1.834 / 2 * sep.sigma(), rel=2e-6)
    with pytest.raises(SynthesisError, match=r"secrecy.candidates: got 2, expected at most 1"):
        synthesise(scenario)


@pytest.mark.parametrize(("most", "steps"), [(50_000, 200), (100, 12)])
def test_a_search_for_an_invariant_set_ends_with_a_remedy(
    most: int, steps: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After too many steps, and after too much work."""
    monkeypatch.setattr("controller_service.sets.packed_design.MOST_ROWS", most)
    scenario = with_control(
        shipped("packed-double-integrator"),
        states=ConvexSet(half_widths=(2000.0, 200.0)),
        inputs=ConvexSet(half_widths=(0.2,)),
    )
    with pytest.raises(SynthesisError, match="narrower bounds, wider") as caught:
        invariant_set(scenario)
    assert int(str(caught.value).split("after ")[1].split()[0]) <= steps
