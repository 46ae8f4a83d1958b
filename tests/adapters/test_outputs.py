"""Every kind of plant read through its position alone: keys, none wrong, also where processes die.

Of a simulation the plant service reads C x and adds the noise; a device's own sensors give y.
"""

import json
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from plant_service.adapters import PlantError
from plant_service.adapters.registry import open_plant
from protocol.agreement import NO_SYMBOL
from protocol.scenario import Scenario
from protocol.vectors import Vector
from tests.adapters.plants import (
    KINDS,
    Device,
    law_of,
    line,
    lives_of,
    through_deaths,
)
from tests.adapters.test_device import line as scenario_of_a_line
from wyner.api import build, run
from wyner.simulate.engine.loop import SimulationError
from wyner.simulate.network import Simulation

NOISE = 0.001
SCALE = 2.0

PUT_BACK = ("linear", "ode", "gymnasium")
"""Kinds that go on from a state: that of the others is lost with a process, and never told."""


def by_position(*, device: bool, **plant: Any) -> Scenario:
    """The double integrator as somebody's own plant, of which the position alone is read."""
    data = json.loads(scenario_of_a_line().model_dump_json(exclude_none=True, exclude_unset=True))
    data["plant"]["C"] = [[1.0, 0.0]]
    data["plant"] |= plant
    data["defender"] |= {
        "disturbance": {"half_widths": [0.005, 0.01]},
        "noise": {"half_widths": [NOISE]},
        "bounds": [20.0, 20.0],
    }
    data["secrecy"] |= {"alpha": 20.0, "candidates": 2}
    if device:
        point = {"state": [0.0], "input": [0.0], "state_scale": [SCALE], "input_scale": [SCALE]}
        data["plant"]["operating_point"] = point
    else:
        data["plant"]["noise"] = {"kind": "corners", "half_widths": [NOISE]}
    return build(data)


def encoder() -> Callable[[Vector], Vector]:
    """A device's sensor: its position, off by a corner of N, in its own unit."""
    draw = random.Random(5)
    return lambda y: (y[0] + SCALE * draw.choice((-NOISE, NOISE)),)


@pytest.mark.parametrize("kind", [*KINDS, "device"])
def test_keys_are_agreed_and_none_is_wrong(kind: str, tmp_path: Path) -> None:
    """200 steps, seed 2: all but a session's first steps agree on the coin, at both ends."""
    scenario = by_position(device=kind == "device")
    both = Simulation(
        scenario,
        law_of(scenario),
        seed=2,
        step_s=1.0 if kind == "device" else None,
        own=lives_of(kind, tmp_path, encoder),
    )
    history = both.run(steps=200)
    made = list(history.plant.values())
    assert len(made) >= 190
    late = [t for t in made if t.tested and t.k > 16]
    assert all(t.symbol == t.coin for t in late)
    assert all(t.symbol in (NO_SYMBOL, t.coin) for t in made)
    assert all(len(t.x) == len(t.x_next) == 1 for t in made)
    for t in made:
        assert (t.truth is None) == (kind not in PUT_BACK)
        if t.truth is not None:
            assert t.verdict.estimate is not None
            low, high = t.verdict.estimate.box
            assert all(a <= v <= b for a, v, b in zip(low, t.truth.x_next, high, strict=True))
    for at, t in history.controller.items():
        assert history.plant[at].shared == t.shared


@pytest.mark.parametrize("kind", ["linear", "python", "device"])
def test_deaths_lose_nothing(kind: str, tmp_path: Path) -> None:
    """Exactly once, and no wrong key, over 3 seeds."""
    through_deaths(by_position(device=kind == "device"), lives_of(kind, tmp_path, encoder))


def test_numbers_that_the_plant_does_not_give_are_one_line(tmp_path: Path) -> None:
    """A simulation gives its states, a device its readings."""
    for device, own in ((True, line("ode", tmp_path)), (False, Device(encoder()))):
        with pytest.raises(PlantError, match="as many as the plant gives"):
            open_plant(by_position(device=device), own=own)


def test_a_device_whose_states_nobody_knows_is_one_line() -> None:
    with pytest.raises(SimulationError, match=r"plant\.C: expected none of a device"):
        run(by_position(device=True), steps=2, plant=Device(encoder()))


def test_noise_that_is_simulated_is_refused_of_a_device() -> None:
    """It was added by :func:`wyner.run` and left out by the service."""
    data = json.loads(scenario_of_a_line().model_dump_json(exclude_none=True, exclude_unset=True))
    data["defender"]["noise"] = {"half_widths": [0.004, 0.004]}
    data["plant"]["noise"] = {"kind": "corners", "half_widths": [0.004, 0.004]}
    scenario, device = build(data), Device()
    with pytest.raises(PlantError, match=r"^plant\.noise: expected none of a device"):
        Simulation(scenario, law_of(scenario), seed=2, step_s=1.0, own=lambda: device)
    with pytest.raises(SimulationError, match=r"^plant\.noise: expected none of a device"):
        run(scenario, steps=2, plant=device)
    assert "apply" not in device.calls
