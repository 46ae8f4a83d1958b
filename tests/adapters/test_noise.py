"""Every kind of plant read through noise: keys, none of them wrong, also where processes die.

A simulation's sensors are simulated (``plant.noise``); a device has noise of its own, and both ends
assume a set for it (``defender.noise``).
"""

import json
import random
from collections.abc import Callable
from pathlib import Path

import pytest

from plant_service.adapters import PlantError
from protocol.scenario import Scenario
from protocol.vectors import Vector
from tests.adapters.plants import KINDS, Device, law_of, lives_of, through_deaths
from tests.adapters.test_device import line as scenario_of_a_line
from wyner.api import build, run
from wyner.simulate.engine import SimulationError
from wyner.simulate.network import Simulation

NOISE = (0.004, 0.004)


def noisy(*, simulated: bool) -> Scenario:
    """The double integrator as somebody's own plant, under a law that allows for noise."""
    data = json.loads(scenario_of_a_line().model_dump_json(exclude_none=True, exclude_unset=True))
    data["defender"]["noise"] = {"half_widths": list(NOISE)}
    if simulated:
        data["plant"]["noise"] = {"kind": "corners", "half_widths": list(NOISE)}
    return build(data)


def own_noise() -> Callable[[Vector], Vector]:
    """A device's sensors: what they add in each reading, at the corners of N, in its own units."""
    draw = random.Random(5)
    return lambda y: tuple(v + 2.0 * draw.choice((-w, w)) for v, w in zip(y, NOISE, strict=True))


@pytest.mark.parametrize("kind", [*KINDS, "device"])
def test_keys_are_agreed_through_noise_and_none_is_wrong(kind: str, tmp_path: Path) -> None:
    """200 steps, seed 2: every tested step agrees on the coin; readings are off by N at most."""
    scenario = noisy(simulated=kind != "device")
    both = Simulation(
        scenario,
        law_of(scenario),
        seed=2,
        step_s=1.0 if kind == "device" else None,
        own=lives_of(kind, tmp_path, own_noise),
    )
    history = both.run(steps=200)
    made = list(history.plant.values())
    assert len(made) >= 190
    tested = [t for t in made if t.tested]
    assert all(t.symbol == t.coin for t in tested)
    off = [
        abs(a - b)
        for t in made
        if t.truth is not None
        for a, b in zip(t.x_next, t.truth.x_next, strict=True)
    ]
    if kind == "device":
        assert not off, "nobody knows a device's own state"
    else:
        assert max(off) == pytest.approx(max(NOISE))
    for at, t in history.controller.items():
        assert history.plant[at].shared == t.shared


@pytest.mark.parametrize("kind", ["linear", "python", "device"])
def test_deaths_lose_nothing_of_what_is_read_through_noise(kind: str, tmp_path: Path) -> None:
    """Exactly once, and no key is wrong in a step whose plant was not put back where it started."""
    through_deaths(noisy(simulated=kind != "device"), lives_of(kind, tmp_path, own_noise))


def test_noise_that_is_simulated_is_refused_of_a_device() -> None:
    """It was added by :func:`wyner.run` and left out by the service."""
    scenario = noisy(simulated=True)
    device = Device(own_noise())
    with pytest.raises(PlantError, match=r"^plant\.noise: expected none of a device"):
        Simulation(scenario, law_of(scenario), seed=2, step_s=1.0, own=lambda: device)
    with pytest.raises(SimulationError, match=r"^plant\.noise: expected none of a device"):
        run(scenario, steps=2, plant=device)
    assert "apply" not in device.calls
