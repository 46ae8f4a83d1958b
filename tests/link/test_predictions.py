"""A nonlinear f_c: its predictions travel with the offer, and both ends test against those."""

from typing import Any

import numpy as np
import pytest

from protocol.link.effects import Notice
from protocol.messages import Offer
from tests.support.safety import violations
from wyner.api import System, design, run, vary
from wyner.simulate.faults import Faults
from wyner.simulate.network import Simulation

MODEL = "runtime.scenarios.plants:predict_pendulum"
FAR = {
    "plant.initial_state": [0.6, -0.5],
    "control.disturbance.half_widths": [0.008, 0.06],
    "control.horizon": 40,
}
"""So far from upright that the tangent model is wrong by more than D_c."""


@pytest.fixture(scope="module")
def linear() -> System:
    return design(vary(design("pendulum").scenario, FAR))


@pytest.fixture(scope="module")
def nonlinear(linear: System) -> System:
    scenario = vary(linear.scenario, {"defender.model": MODEL})
    return System(scenario, linear.design, linear.law)


def applied(runs: Any) -> Any:
    return np.take_along_axis(runs.gauges, runs.coin[:, :, None].astype(np.intp), axis=2)


def test_what_the_tangent_model_gets_wrong_the_model_gets_right(
    linear: System, nonlinear: System
) -> None:
    wrong, right = (run(s, steps=60, runs=4, seed=1) for s in (linear, nonlinear))
    assert applied(wrong).max() > 1.2
    assert applied(right).max() <= 1.0
    tested = (right.message_symbol < 0).sum()
    assert (right.key >= 0).sum() == tested


def test_both_ends_keep_step_over_a_bad_network(nonlinear: System) -> None:
    payloads = (b"one", b"two")
    faults = Faults(loss=0.2, repeat=0.1, delay_s=0.05, crash=0.005, until_s=100.0)
    world = Simulation(nonlinear.scenario, nonlinear.law, seed=2, payloads=payloads, faults=faults)
    history = world.run(seconds=900, until=lambda: len(world.history.delivered) == 2)
    assert list(violations(history, payloads)) == []
    assert history.inbox == list(payloads)
    t = next(iter(history.plant.values()))
    assert len(t.predictions) == 4
    assert t.as_event()["predictions"] == t.predictions
    assert all(offer.predictions for _, offer in history.offered)


@pytest.mark.parametrize(
    ("model", "predictions", "says"),
    [
        (False, ((0.0, 0.0),) * 4, "offer.predictions: expected none, as f_c is linear"),
        (True, (), "offer.predictions: expected 4 predictions of 2 states"),
        (True, ((0.0,),) * 4, "offer.predictions: expected 4 predictions of 2 states"),
    ],
)
def test_predictions_of_another_kind_are_malformed(
    model: bool, predictions: Any, says: str, linear: System, nonlinear: System
) -> None:
    system = nonlinear if model else linear
    world = Simulation(system.scenario, system.law, seed=2)
    world.run(steps=2)
    record = world.plant.state.record
    offer = Offer(
        session=record.session.id,
        k=record.link.k,
        candidates=((0.0,),) * 4,
        cipher=0,
        predictions=predictions,
    )
    (said,) = world.plant.receive(Offer, offer.wire(), world.now_s)
    assert isinstance(said, Notice)
    assert says in said.text
    assert world.plant.state.record == record
