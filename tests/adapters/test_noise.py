"""Noise that a simulation is to have, and a device has of its own."""

import json

import pytest

from plant_service.adapters import PlantError
from tests.adapters.plants import Device, law_of
from tests.adapters.test_device import line
from wyner.api import build, run
from wyner.simulate.engine import SimulationError
from wyner.simulate.network import Simulation


def test_noise_that_is_simulated_is_refused_of_a_device() -> None:
    """It was added by :func:`wyner.run` and left out by the service."""
    data = json.loads(line().model_dump_json(exclude_none=True, exclude_unset=True))
    data["defender"]["noise"] = {"half_widths": [0.004, 0.004]}
    data["plant"]["noise"] = {"kind": "corners", "half_widths": [0.004, 0.004]}
    scenario, device = build(data), Device()
    with pytest.raises(PlantError, match=r"^plant\.noise: expected none of a device"):
        Simulation(scenario, law_of(scenario), seed=2, step_s=1.0, own=lambda: device)
    with pytest.raises(SimulationError, match=r"^plant\.noise: expected none of a device"):
        run(scenario, steps=2, plant=device)
    assert "apply" not in device.calls
