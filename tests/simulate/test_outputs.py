"""A plant read through some outputs alone: both ends, the engine, and what is refused."""

from typing import Any

import numpy as np
import pytest

from protocol.agreement import predict
from protocol.link.session import CountedTransition
from protocol.scenario import ScenarioError
from tests.simulate.beside import beside_the_engine, through_deaths_and_losses
from tests.support.recorded_pair import law_of
from tests.support.scenarios import changed
from tests.support.size import size
from wyner import api

LOSSES = {"to_plant": {"loss": 0.3}, "to_controller": {"loss": 0.3}}
BURSTS = {
    "to_plant": {"delay": "gamma", "delay_s": 0.05, "jitter_s": 0.05},
    "to_controller": {"loss_bad": 0.9, "to_bad": 0.1, "to_good": 0.2},
}


def held(t: CountedTransition) -> bool:
    """Whether the state after a transition is in the box of both ends."""
    assert t.truth is not None
    assert t.verdict.estimate is not None
    low, high = t.verdict.estimate.box
    return all(a <= v <= b for a, v, b in zip(low, t.truth.x_next, high, strict=True))


@pytest.mark.parametrize("fallback", ["hold", "zero", "regulator"])
@pytest.mark.parametrize("network", [None, LOSSES, BURSTS])
def test_the_engine_is_the_two_ends_to_the_last_bit(
    network: dict[str, Any] | None, fallback: str
) -> None:
    """Readings, states, coins and symbols, over missed steps too; the box holds the state."""
    tables = {} if network is None else {"network": network}
    scenario = changed("encoder", link={"fallback": fallback}, **tables)
    _, law = law_of("encoder")
    assert all(held(t) for t in beside_the_engine(scenario, law, size(60, 150)))


@pytest.mark.parametrize("network", [None, LOSSES])
def test_a_plant_of_ones_own_gives_the_engines_run_to_the_last_bit(
    network: dict[str, Any] | None,
) -> None:
    """Readings, verdicts and what they take of alpha, over missed steps too; seed 3."""
    tables = {} if network is None else {"network": network}
    scenario = changed("encoder", plant={"disturbance": {"enters": "none"}}, **tables)

    class Own:
        """The scenario's plant as an object."""

        def reset(self, seed: int | None) -> tuple[float, ...]:
            self.x = scenario.initial_state
            return self.x

        def step(self, u: tuple[float, ...], period_s: float) -> tuple[float, ...]:
            self.x = predict(scenario.A, scenario.B, self.x, u)
            return self.x

    still = changed("encoder", plant={"disturbance": {"half_widths": [0.0, 0.0]}}, **tables)
    own = api.run(scenario, steps=80, runs=2, seed=3, plant=Own())
    together = api.run(still, steps=80, runs=2, seed=3)
    pairs: list[tuple[Any, Any]] = [
        (own.x, together.x),
        (own.u, together.u),
        (own.candidates, together.candidates),
        (own.gauges, together.gauges),
        (own.coin, together.coin),
        (own.key, together.key),
        (own.record.largest, together.record.largest),
        (own.record.truth, together.record.truth),
    ]
    for mine, theirs in pairs:
        assert np.array_equal(mine, theirs, equal_nan=True)
    assert own.agreements.sum() > 60


def test_deaths_and_a_bad_network_break_nothing() -> None:
    """Exactly once, the box at both ends the same and around the state, over 4 seeds."""
    for history in through_deaths_and_losses(*law_of("encoder")):
        assert history.record is not None
        assert history.record.applied.symbol_errors == 0
        assert all(map(held, history.plant.values()))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"defender": {"bounds": None}}, "defender.bounds: got none"),
        ({"defender": {"bounds": [1.0]}}, "defender.bounds: got shape 1, expected 2"),
        ({"defender": {"noise": None}}, "defender.noise: expected half_widths"),
        ({"defender": {"noise": {"half_widths": [0.1, 0.1]}}}, "defender.noise: got shape 2"),
        ({"plant": {"C": [[1.0]]}}, "plant.C: got shape"),
        ({"plant": {"C": None}}, "defender.bounds: expected none"),
        ({"control": {"disturbance": {"half_widths": [0.0005, 0.01]}}}, "control.disturbance"),
    ],
)
def test_wrong_outputs_are_one_line(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(ScenarioError, match=says):
        changed("encoder", **changes)


def test_the_fingerprint_covers_what_the_box_depends_on() -> None:
    """C, bounds, N, and what is predicted of a missed step."""
    plain = changed("encoder")
    others = (
        changed("encoder", defender={"bounds": [10.0, 11.0]}),
        changed("encoder", defender={"noise": {"half_widths": [0.00013]}}),
        changed("encoder", link={"fallback": "zero"}),
        changed("encoder", control={"gain": [[-5.0, -2.0]]}),
    )
    assert len({s.fingerprint() for s in (plain, *others)}) == 5
