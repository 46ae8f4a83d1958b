"""What the tap sees: the knobs do what they say, and the same seed does it again."""

import math
import statistics

import pytest
from pydantic import ValidationError

from protocol.knowledge import Knowledge, Policy
from protocol.messages import FieldMessage, Measurement, Offer
from protocol.scenario import TapView
from tap_service.capture.channel import View, WiretapChannel
from tap_service.eavesdroppers import named

S = "f" * 16
MESSAGES: list[FieldMessage] = []
for k in range(500):
    x = (math.sin(k), math.cos(k))
    MESSAGES.append(Measurement(session=S, k=k, x=x, applied_k=k - 1, x_after=x if k else ()))
    MESSAGES.append(Offer(session=S, k=k, candidates=((0.1 * k,), (0.2,)), cipher=k % 2))

KNOWLEDGE = Knowledge(
    scenario="s",
    period_s=0.1,
    candidates=2,
    A=((1.0, 0.5), (0.0, 2.0)),
    B=((1.0,), (3.0,)),
    disturbance_H=((1.0, 0.0),),
    disturbance_h=(1.0,),
    policy=Policy(law="paper", costs=(), gain=((1.0, 2.0),)),
)


def seen(view: View) -> list[FieldMessage]:
    channel = WiretapChannel(view)
    out = [m for i, message in enumerate(MESSAGES) for _, m in channel.hear(i, message)]
    return out + [m for _, m in channel.rest()]


def test_a_clear_view_changes_nothing() -> None:
    assert View().clear
    assert seen(View()) == MESSAGES


def test_loss_takes_each_message_with_its_probability() -> None:
    share = 1 - len(seen(View(loss=0.3, seed=1))) / len(MESSAGES)
    assert abs(share - 0.3) < 4 * math.sqrt(0.21 / len(MESSAGES))
    assert seen(View(loss=1.0)) == []


@pytest.mark.parametrize(("view", "kind"), [("measurements", Measurement), ("offers", Offer)])
def test_one_direction(view: str, kind: type) -> None:
    got = seen(View.model_validate({"view": view}))
    assert got == [m for m in MESSAGES if isinstance(m, kind)]


def test_delay_holds_back_and_loses_nothing() -> None:
    channel = WiretapChannel(View(delay=7))
    counts = [len(list(channel.hear(i, m))) for i, m in enumerate(MESSAGES)]
    assert counts == [0] * 7 + [1] * (len(MESSAGES) - 7)
    assert seen(View(delay=7)) == MESSAGES


def test_noise_has_its_deviation_and_leaves_the_cipher_alone() -> None:
    got = seen(View(noise=0.05, seed=2))
    errors = []
    for was, now in zip(MESSAGES, got, strict=True):
        if isinstance(was, Offer):
            assert isinstance(now, Offer)
            assert now.cipher == was.cipher
            errors += [b[0] - a[0] for a, b in zip(was.candidates, now.candidates, strict=True)]
        else:
            assert isinstance(now, Measurement)
            assert now.x == now.x_after or was.k == 0
            errors += [b - a for a, b in zip(was.x, now.x, strict=True)]
    assert statistics.pstdev(errors) == pytest.approx(0.05, rel=0.1)
    assert abs(statistics.fmean(errors)) < 0.01


def test_quantising_rounds_to_the_step() -> None:
    for message in seen(View(quantise=0.25)):
        values = message.x if isinstance(message, Measurement) else message.candidates[0]
        assert all(v % 0.25 == 0 for v in values)


def test_the_same_seed_sees_the_same() -> None:
    view = View(loss=0.2, noise=0.01, delay=3, seed=5)
    assert seen(view) == seen(view)
    assert seen(view) != seen(view.model_copy(update={"seed": 6}))


def test_a_model_error_is_relative_to_each_entry() -> None:
    wrong = View(model_error=0.3, seed=4).knowledge(KNOWLEDGE)
    assert wrong.A is not None
    assert KNOWLEDGE.A is not None
    for row, was in zip(wrong.A, KNOWLEDGE.A, strict=True):
        for value, old in zip(row, was, strict=True):
            assert abs(value - old) == pytest.approx(0.3 * abs(old))
    assert wrong == View(model_error=0.3, seed=4).knowledge(KNOWLEDGE)
    assert View().knowledge(KNOWLEDGE) == KNOWLEDGE


def test_the_learner_is_told_nothing_unless_wrongly() -> None:
    learning, decoder = named("learning"), named("list-decoder")
    nothing = View().knowledge(KNOWLEDGE, model=learning.told_model)
    assert nothing.A is None
    assert nothing.disturbance_h is None
    assert nothing.policy is None
    assert View(model_error=0.5).knowledge(KNOWLEDGE, model=learning.told_model).A is not None
    assert View().knowledge(KNOWLEDGE, model=decoder.told_model) == KNOWLEDGE


@pytest.mark.parametrize(
    "bad", [{"loss": 1.5}, {"loss": -0.1}, {"view": "none"}, {"noise": -1}, {"delay": -1}, {"x": 1}]
)
def test_wrong_knobs_are_refused(bad: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        View.model_validate(bad)


@pytest.mark.parametrize("knob", ["view", "loss", "noise", "quantise", "delay", "model_error"])
def test_a_knob_has_the_same_bounds_in_a_scenario_and_at_the_tap(knob: str) -> None:
    ours = View.model_json_schema()["properties"][knob]
    theirs = TapView.model_json_schema()["properties"][knob]
    for words in ("title", "description"):
        ours.pop(words, None), theirs.pop(words, None)
    assert ours == theirs
