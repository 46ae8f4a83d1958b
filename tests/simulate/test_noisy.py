"""Readings with noise: W in the defender's half of the test, and the same run in every place."""

from typing import Any

import numpy as np
import pytest

from protocol.agreement import Gauge, predict
from protocol.link.session import rules_of
from protocol.scenario import ScenarioError
from tests.simulate.beside import beside_the_engine, through_deaths_and_losses
from tests.support.recorded_pair import law_of
from tests.support.scenarios import changed
from wyner.runs.score.counts import costs


def test_w_is_the_sum_of_three_sets() -> None:
    """The paper's plant, N of 0.024: 0.12 + 0.024 + (1 + 0.0975) 0.024 = 0.17034 in x_1."""
    scenario, _ = law_of("noisy")
    widths = scenario.test_set.half_widths
    assert widths == pytest.approx((0.17034, 0.12 + 0.024 * 1.9512))
    gauge = Gauge.from_rows(*scenario.test_set.rows())
    draw = np.random.default_rng(1)
    corners = draw.choice([-1.0, 1.0], size=(500, 3, 2))
    for d, before, after in corners.tolist():
        moved = predict(scenario.A, ((0.0,), (0.0,)), [0.024 * v for v in before], (0.0,))
        terms = zip(d, after, moved, strict=True)
        assert gauge([0.12 * a + 0.024 * b - c for a, b, c in terms]) <= 1 + 1e-12


def test_what_is_possible_for_her_is_said_by_the_offer() -> None:
    """Whether centres lie within (alpha - 1) D_c, whatever the reading after them."""
    rule = rules_of(changed("noisy", secrecy={"candidates": 3})).agreement
    near, far = 0.12 * 6.99, 0.12 * 7.01
    for distance, agreed in ((near, True), (far, False)):
        centres = ((0.0, 0.0), (0.0, 0.5), (0.0, distance))
        assert rule.verdict_at(centres, (0.0, 0.1)).agreed is agreed
        assert rule.widest(centres, (9.0, 9.0)) == pytest.approx(1 + distance / 0.12)


@pytest.mark.parametrize("network", [None, {"to_plant": {"loss": 0.4}}])
def test_the_engine_runs_as_the_two_ends_do(network: dict[str, Any] | None) -> None:
    """Readings, coins and key symbols to the last bit, and the state itself; seed 4."""
    scenario, law = law_of("noisy")
    if network is not None:
        scenario = changed("noisy", network=network)
    for t in beside_the_engine(scenario, law, 100):
        assert t.truth is not None
        assert max(np.abs(np.subtract(t.truth.x_next, t.x_next))) <= 0.02 + 1e-12


def test_deaths_and_a_bad_network_break_nothing() -> None:
    """Exactly once, and one state whatever is counted again: 4 seeds."""
    assert len(list(through_deaths_and_losses(*law_of("noisy")))) == 4


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"plant": {"noise": {"half_widths": [0.1, 0.1]}}}, "plant.noise: expected a set inside"),
        ({"plant": {"noise": {"half_widths": [0.01]}}}, r"plant.noise: got shape 1, expected 2"),
        ({"defender": {"noise": {"half_widths": [0.0]}}}, r"defender.noise: got shape 1"),
        ({"secrecy": {"disturbance": {"half_widths": [0.2, 0.2]}}}, "expected none beside"),
        (
            {"plant": {"noise": {"H": [[1.0, 0.0]], "h": [0.1]}}},
            "expected 'corners' for a polytope",
        ),
    ],
)
def test_wrong_noise_is_one_line(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(ScenarioError, match=says):
        changed("noisy", **changes)


@pytest.mark.parametrize(
    ("share", "candidates"), [(0.05, 4), (0.085, 4), (0.09, 3), (0.3, 3), (0.39, 2), (0.5, 2)]
)
def test_how_many_candidates_the_noise_leaves(share: float, candidates: int) -> None:
    """M of `packed` at alpha = 8, the noise a share of D_c in each coordinate."""
    from controller_service.sets.alphabet import choose_alphabet
    from controller_service.sets.separation import AlphabetError

    scenario = changed(
        "noisy",
        plant={"noise": {"half_widths": [0.0, 0.0]}},
        defender={"noise": {"half_widths": [0.12 * share] * 2}},
    )
    alphabet = {
        "B": scenario.B,
        "disturbance": scenario.defender.disturbance,
        "inputs": scenario.control.inputs,
        "alpha": 8.0,
        "tested": scenario.test_set,
    }
    assert len(choose_alphabet(size=candidates, **alphabet).offsets) == candidates  # type: ignore[arg-type]
    with pytest.raises(AlphabetError, match=f"expected at most {candidates}"):
        choose_alphabet(size=candidates + 1, **alphabet)  # type: ignore[arg-type]


def test_one_who_knows_her_own_set_lacks_the_noise_too() -> None:
    """One width of D_c, and two of N."""
    assert law_of("noisy")[0].hidden_widths == 3
    assert law_of("sustained")[0].hidden_widths == 1


def test_the_cost_of_a_run_is_that_of_the_state_itself() -> None:
    pair = ("f8", (2,))
    columns = [("x_next", *pair), ("u", "f8", (1,)), ("true_x", *pair), ("true_u", "f8", (1,))]
    silent = ((9.0, 9.0), (0.5,), (np.nan, np.nan), (np.nan,))
    told = ((9.0, 9.0), (0.25,), (1.0, 7.0), (0.5,))
    rows = np.array([silent, told], np.dtype(columns))
    assert costs(((2.0, 0.0), (1.0,)), rows).tolist() == [2 * 81 + 0.25, 2 + 0.25]
