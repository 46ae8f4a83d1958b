"""One step of a plant is the same, whatever the plant is: the stepper's functions, in one order."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

import plant_service.stepper
from plant_service.adapters import PlantAdapter
from plant_service.plant import Disturbances, LinearModel, OperatedPlant, Plant
from protocol.link.session import rules_of
from protocol.messages import ControllerHello, Offer
from protocol.scenario import Scenario
from protocol.streams import Stream
from tests.adapters.plants import START, Device, line, operated
from tests.support.plant_in_hand import PlantInHand
from tests.support.records import plant_record
from wyner.api import load

SESSION = "5" * 16
STEPPER = plant_service.stepper.__file__
STEP = ["wrong", "offered", "place", "read", "count"]
"""Of a step, in the order of Fig. 6: an offer, checked and applied; the reading, said, counted."""


def _model(scenario: Scenario, folder: Path) -> Plant:
    return LinearModel(scenario, _disturbances(scenario))


def _disturbances(scenario: Scenario) -> Disturbances:
    return Disturbances(scenario, Stream(1, 0, width=scenario.n))


def _adapter(kind: str, scenario: Scenario, folder: Path) -> Plant:
    made: PlantAdapter = Device() if kind == "device" else line(kind, folder)
    opened = operated(made)
    opened.start(1)
    return OperatedPlant(opened, _disturbances(scenario), "none")


PLANTS: dict[str, Callable[[Scenario, Path], Plant]] = {
    "model": _model,
    **{
        kind: partial(_adapter, kind)
        for kind in ("ode", "python", "gymnasium", "fmi2", "fmi3", "device")
    },
}


@contextmanager
def entered(names: list[str]) -> Iterator[None]:
    """Note each function of the plant's stepper that is entered."""

    frames: list[FrameType] = []

    def note(frame: FrameType, event: str, argument: Any) -> None:
        if event == "call" and frame.f_code.co_filename == STEPPER and frame not in frames:
            frames.append(frame)  # one that goes on was entered before
            names.append(frame.f_code.co_name)

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        yield
    finally:
        sys.setprofile(before)


def _met(plant: PlantInHand) -> None:
    """A controller takes the session up."""
    hello = ControllerHello(
        instance="2" * 16,
        incarnation=1,
        fingerprint=plant.core.state.rules.fingerprint,
        verdict="greeting",
    )
    plant.hear(ControllerHello, hello.wire())
    accepted = hello.model_copy(
        update={"verdict": "accepted", "session": SESSION, "answers": plant.core.instance}
    )
    plant.hear(ControllerHello, accepted.wire())
    assert plant.accepted


@pytest.mark.parametrize("kind", PLANTS)
def test_a_step_goes_the_same_way_in_every_plant(kind: str, tmp_path: Path) -> None:
    scenario = load("packed-double-integrator")
    rules = rules_of(scenario)
    record = plant_record(session=SESSION, k=0, x=START, u=(0.0,), state=rules.scheme.restore(()))
    plant = PlantInHand(rules, "1" * 16, record, plant=PLANTS[kind](scenario, tmp_path))
    _met(plant)
    offered = Offer(
        session=SESSION,
        k=0,
        candidates=tuple((0.1 * i,) for i in range(rules.size)),
        cipher=0,
    )
    names: list[str] = []
    with entered(names):
        counted = plant.takes(offered)
    assert [name for name in dict.fromkeys(names) if name in STEP] == STEP
    assert [names.count(name) for name in STEP] == [1] * len(STEP)
    assert plant.core.state.record.link.k == 1
    assert counted.u == offered.candidates[counted.coin]
    plant.core.stepper.plant.close()


def test_a_device_saves_its_coin_before_it_moves_and_a_model_after() -> None:
    """The one thing in which they differ: what cannot be made again is saved before."""
    scenario = load("packed-double-integrator")
    assert not _model(scenario, Path()).acts
    assert _adapter("device", scenario, Path()).acts
