"""Shipped scenarios and variants: the engine's run is the cores', to the last bit."""

import random
from typing import Any

import pytest

from controller_service.laws.registry import cached_design, make_law
from protocol.agreement import NO_SYMBOL
from tests.simulate.beside import beside_the_engine
from tests.support.scenarios import changed
from wyner.api import design, load, scenario_names
from wyner.simulate.engine import simulate_runs

STEPS = 60
"""Fewer than a block of keys has: from then on a keyed coin is the cores' alone."""

POLYTOPE: dict[str, Any] = {
    "plant": {"initial_state": [1.0, -0.5]},
    "defender": {
        "A": [[1.0, 0.0974], [0.0, 0.9513]],
        "disturbance": {
            "H": [[1.0, 0.2], [-1.0, 0.1], [0.0, 1.0], [0.1, -1.0], [1.0, 1.0]],
            "h": [0.14, 0.14, 0.13, 0.14, 0.23],
        },
    },
    "secrecy": {"candidates": 3},
    "control": {
        "horizon": 30,
        "costs": [{"next_state": 1.0}, {"input": 1.0}, {"next_state": 1.0, "input": 0.2}],
    },
}
"""Three candidates, and a defender whose model is not the plant's."""

DISTURBED = [
    {"plant": {"disturbance": {"kind": kind, "half_widths": [0.1, 0.1], "deviation": 0.7}}}
    for kind in ("corners", "constant", "sinusoid", "gaussian", "truncated-gaussian")
]


def without_keys() -> list[str]:
    """The scenarios in which no key chooses or seals anything: the engine makes none."""
    found = ((name, load(name)) for name in scenario_names())
    return [n for n, s in found if s.secrecy.scheme != "sealed" and s.defence.coin == "private"]


@pytest.mark.parametrize("name", without_keys())
def test_engine_and_cores_are_one_system(name: str) -> None:
    system, draw = design(name), random.Random(f"held out {name}")
    seed, run = draw.randrange(2**31), draw.randrange(5)
    beside_the_engine(system.scenario, system.law, STEPS, seed=seed, run=run, folder=system.folder)


OWN_SHAPE = {"secrecy": {"alpha": 1.0, "disturbance": {"half_widths": [0.24, 0.96]}}}
"""Eve's set is not the two ends' made larger."""


@pytest.mark.parametrize("name", ["paper", "sustained", "packed", "quadruple-tank"])
def test_and_so_they_are_past_the_first_block_of_draws(name: str) -> None:
    system = design(name)
    beside_the_engine(system.scenario, system.law, 300, folder=system.folder)


@pytest.mark.parametrize("changes", [POLYTOPE, OWN_SHAPE, *DISTURBED])
def test_and_so_are_those_of_every_disturbance_and_set(changes: dict[str, Any]) -> None:
    scenario = changed("sustained", **changes)
    law = make_law(scenario, cached_design(scenario))
    beside_the_engine(scenario, law, 200)
    runs = simulate_runs(scenario, law, seed=4, runs=range(5), steps=200)
    assert set(runs.symbol.ravel()) > {NO_SYMBOL}
