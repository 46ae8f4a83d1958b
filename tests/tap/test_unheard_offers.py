"""Readings of the state alone, before `text`: the symbols of every plant, by law and likelihood."""

import numpy as np
import pytest

from protocol.knowledge import Knowledge
from studies.listeners import heard, heard_of
from studies.secrecy.runs import simulate
from studies.secrecy.study import heard_by
from tap_service.capture.channel import View
from tap_service.capture.transcript import Transition
from tap_service.inference.law import KnownLaw
from tap_service.inference.unheard_offers import infer_from_readings, unit_offsets
from tap_service.inference.verdicts import InferredStep
from tests.support.shipped_run import shipped_run
from wyner.simulate.engine import transfer


def by_readings(k: Knowledge, heard: list[Transition], noise: float = 0.0) -> list[InferredStep]:
    law = KnownLaw.of(k)
    assert law is not None
    shape = np.array(k.disturbance_H) / np.array(k.disturbance_h)[:, None]
    A, B = np.array(k.A), np.array(k.B)
    return infer_from_readings(A, B, shape, law, k.candidates, noise, heard).steps


@pytest.mark.parametrize(
    ("scenario", "steps", "least"),
    [
        ("packed-quadruple-tank", 240, 0.92),
        ("packed-batch-reactor", 240, 0.92),
        ("nonlinear-quadruple-tank", 120, 0.97),
        ("unicycle", 120, 0.97),
        ("noisy", 240, 0.90),
        ("packed-double-integrator", 240, 0.92),
        ("packed", 240, 0.95),
        ("quadruple-tank", 240, 0.90),
        ("sustained", 240, 0.95),
    ],
)
def test_the_keys_of_every_plant_by_its_readings(scenario: str, steps: int, least: float) -> None:
    run = shipped_run(scenario, steps, 1)
    (made,) = heard(("text",), run, View(view="measurements", seed=1))
    assert made.keys
    assert made.known > least * made.keys


@pytest.mark.parametrize(
    "scenario", ["packed", "packed-quadruple-tank", "packed-batch-reactor", "unicycle"]
)
def test_one_of_the_shapes_is_the_alphabet(scenario: str) -> None:
    runs, _ = shipped_run(scenario, 2, 0)
    k = runs.scenario.knowledge()
    assert runs.candidates is not None
    offer = runs.candidates[1, :, :, 0]
    offsets = offer - 0.5 * (offer.min(axis=0) + offer.max(axis=0))
    H, h = np.array(k.disturbance_H), np.array(k.disturbance_h)
    edge = 1 / np.abs(H / h[:, None]).max(axis=0)
    off = []
    for unit in unit_offsets(np.array(k.B), edge, k.candidates):
        scale = (unit * offsets).sum() / (unit**2).sum()
        off.append(np.abs(scale * unit - offsets).max())
    assert min(off) < 1e-6


def test_how_sure_she_is_of_a_step_is_how_often_she_is_right() -> None:
    runs, _ = shipped_run("noisy", 400, 3)
    link = transfer(runs, payloads=[])
    said = heard_of(runs, link, View(view="measurements"))
    stated, right = 0.0, 0
    for step in by_readings(runs.scenario.knowledge(), said):
        assert step.samples is not None
        shares = np.bincount(step.samples.argmin(axis=1), minlength=3) / len(step.samples)
        stated += float(shares.max())
        right += int(shares.argmax()) == runs.coin[step.transition.k, 0]
    assert abs(stated - right) < 0.06 * len(said)


@pytest.mark.parametrize("name", ["sustained", "packed"])
def test_a_lost_state_leaves_its_steps_open(name: str) -> None:
    run = simulate(90, 1, name=name)
    heard = heard_by(run, View(view="measurements", loss=0.2, seed=1))
    k = run.scenario.knowledge()
    open_steps = [s.transition for s in by_readings(k, heard) if s.samples is None]
    assert open_steps
    assert open_steps == [t for t in heard if t.x is None or t.x_next is None]
    nothing = [Transition("s", 0, None, None, None, None)]
    assert by_readings(k, nothing)[0].samples is None
