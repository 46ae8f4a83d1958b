"""Shipped scenarios and variants: the engine's run is the cores', to the last bit."""

import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controller_service.laws.registry import cached_design, make_law
from protocol.agreement import NO_SYMBOL
from protocol.scenario import Scenario
from wyner.api import design, load, scenario_names
from wyner.simulate.engine import Law, simulate_runs, transfer
from wyner.simulate.network import Simulation

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


def compare(scenario: Scenario, law: Law, seed: int, run: int, folder: Path, steps: int) -> None:
    """A run of the engine, among others, beside the cores' on a virtual clock."""
    record = simulate_runs(
        scenario, law, seed=seed, runs=range(run, run + 2), steps=steps, record=True, folder=folder
    )
    link = transfer(record, payloads=[b"ok"])
    ends = Simulation(
        scenario,
        law,
        seed=seed,
        run=run,
        payloads=(b"ok",),
        step_s=None if scenario.network is None else scenario.plant.period_s,
        folder=folder,
    )
    history = ends.run(steps=steps)
    assert record.x is not None
    assert record.u is not None
    assert record.candidates is not None
    assert record.gauges is not None
    done = [t for t in history.plant.values() if t.k < steps]
    missed = [] if record.missed is None else record.missed[:, 0].nonzero()[0].tolist()
    assert [t.k for t in done] == [k for k in range(steps) if k not in missed]
    for t in done:
        assert t.x == tuple(record.x[t.k, :, 0])
        assert t.candidates == tuple(map(tuple, record.candidates[t.k, :, :, 0].tolist()))
        assert t.x_next == tuple(record.x[t.k + 1, :, 0])
        assert t.verdict.gauges == tuple(record.gauges[t.k, :, 0])
        assert t.coin == record.coin[t.k, 0]
        assert t.cipher == link.cipher[t.k, 0]
        assert (t.symbol, t.key) == (link.agreed[t.k, 0], link.pad[t.k, 0])
        assert t.message_symbol == link.message_symbol[t.k, 0]
    x = record.x if record.truth is None else record.truth
    assert record.state_cost == pytest.approx((x[1:] ** 2).sum(axis=(0, 1)))
    assert record.input_effort == pytest.approx((record.u**2).sum(axis=(0, 1)))
    Q, R = scenario.cost_weights
    costs = np.einsum("knr,n->r", x[1:] ** 2, Q) + np.einsum("kmr,m->r", record.u**2, R)
    assert record.cost == pytest.approx(costs)


@pytest.mark.parametrize("name", without_keys())
def test_engine_and_cores_are_one_system(name: str) -> None:
    system, draw = design(name), random.Random(f"held out {name}")
    seed, run = draw.randrange(2**31), draw.randrange(5)
    compare(system.scenario, system.law, seed, run, system.folder, STEPS)


OWN_SHAPE = {"secrecy": {"alpha": 1.0, "disturbance": {"half_widths": [0.24, 0.96]}}}
"""Eve's set is not the two ends' made larger."""


@pytest.mark.parametrize("name", ["paper", "sustained", "packed", "quadruple-tank"])
def test_and_so_they_are_past_the_first_block_of_draws(name: str) -> None:
    system = design(name)
    compare(system.scenario, system.law, 11, 2, system.folder, 300)


@pytest.mark.parametrize("changes", [POLYTOPE, OWN_SHAPE, *DISTURBED])
def test_and_so_are_those_of_every_disturbance_and_set(changes: dict[str, Any]) -> None:
    data = load("sustained").model_dump(mode="json", exclude_none=True)
    for table, fields in changes.items():
        data[table] = data[table] | fields
    scenario = Scenario.model_validate(data)
    law = make_law(scenario, cached_design(scenario))
    compare(scenario, law, 4, 3, Path(), 200)
    runs = simulate_runs(scenario, law, seed=4, runs=range(5), steps=200)
    assert set(runs.symbol.ravel()) > {NO_SYMBOL}
