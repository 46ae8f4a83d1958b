"""What either end says where it refuses, word for word, and what it remembers afterwards."""

from dataclasses import replace
from math import nextafter
from typing import Any

import pytest

from controller_service.chooser import STALE
from protocol.agreement import INSIDE, AgreementRule, Gauge
from protocol.link.controller_session import REMEMBERED_SESSIONS
from protocol.link.distiller import BlockEnded
from protocol.link.records import ControllerRecord, PlantRecord
from protocol.link.session import Rules
from protocol.messages import ControllerHello, Measurement, Offer, PlantHello
from protocol.schemes.framing import encode_frame
from protocol.schemes.switched import Switched
from protocol.secret.blocks import NO_TAG, ExtractedBlock, Schedule
from protocol.secret.bound import Assumption
from protocol.secret.nonces import Contribution
from protocol.vectors import Vector
from runtime.chance import fresh_nonce
from tests.support.asked import gathered
from tests.support.controller_in_hand import NOTHING, ControllerInHand, Done
from tests.support.line_ends import line_rules
from tests.support.plant_in_hand import PlantInHand
from tests.support.records import changed, controller_record, plant_record

RULES = line_rules(alpha=4.0, largest_input=5.0)
OTHER = "e" * 64
S, T, NEW = "1" * 16, "2" * 16, "9" * 16
A, B, P, Q = (letter * 16 for letter in "abcd")
CANDIDATES = ((1.5,), (-1.5,))


def propose(x: Vector) -> tuple[Vector, ...]:
    if x[0] > 100:
        raise LookupError(f"no answer at {x[0]:g}")
    return CANDIDATES


def controller(
    record: ControllerRecord | None = None, rules: Rules = RULES, **more: Any
) -> ControllerInHand:
    """A process that is the life of its journal which ``record`` counts."""
    read = None if record is None else changed(record, incarnation=record.session.incarnation - 1)
    return ControllerInHand(rules, propose, A, read, **more)


def hello(**fields: object) -> PlantHello:
    made = PlantHello(
        instance=P,
        session=S,
        controller=A,
        incarnation=1,
        fingerprint=RULES.fingerprint,
        transitions=0,
        applied_k=-1,
    )
    return made.model_copy(update=fields)


def reply(verdict: str, **fields: object) -> ControllerHello:
    made = ControllerHello(
        instance=A,
        incarnation=1,
        fingerprint=RULES.fingerprint,
        verdict="greeting",
        session=S,
        answers=P,
    )
    return made.model_copy(update={"verdict": verdict, **fields})


def measurement(**fields: object) -> Measurement:
    made = Measurement(session=S, k=4, x=(0.5,), applied_k=3, x_after=(0.5,))
    return made.model_copy(update=fields)


GREETING = reply("greeting", session=None, answers=None)
OFFER = Offer(session=S, k=3, candidates=CANDIDATES, cipher=0)
RECORD = controller_record(
    session=S,
    incarnation=1,
    ended=(T,),
    state=Switched(2).initial,
    k=3,
    applied_k=1,
    transitions=2,
    agreements=1,
    p=1,
    message=5,
    offset=7,
    x=(0.0,),
    offer=OFFER,
)
OVER = controller_record(incarnation=1, ended=(T, S), state=Switched(2).initial, message=5)
"""What is left of :data:`RECORD` when its session is over: the message starts again."""


def at_work() -> ControllerInHand:
    sender = controller(RECORD)
    assert sender.heard_plant(hello(transitions=2, applied_k=1)).reply == reply("accepted")
    assert sender.plant == P
    return sender


# --- hellos ---------------------------------------------------------------------------------------


def test_the_first_word_names_the_session_of_the_journal() -> None:
    assert controller().greeting() == reply("greeting", session=None, answers=None)
    assert controller(RECORD).greeting() == reply("greeting", session=S, answers=None)


def test_another_model_is_named() -> None:
    sender = controller()
    said = sender.heard_plant(hello(fingerprint=OTHER))
    assert said == Done(reply=reply("other-model"), refusal=f"plant {P} shares another model")
    assert sender.refused
    assert not sender.heard_plant(hello()).refusal
    for record in (RECORD, OVER):  # it has met a plant of its own
        sender = controller(record)
        assert sender.heard_plant(hello(fingerprint=OTHER)).reply == reply("other-model")
        assert not sender.refused


def test_a_second_plant_is_named_while_the_first_runs() -> None:
    sender = at_work()
    assert sender.measured(measurement(k=3, applied_k=1, x=(0.0,))).offer == OFFER
    why = f"plant {Q} speaks up while plant {P} runs: two plants on one loop?"
    assert sender.heard_plant(hello(instance=Q, session=NEW), running=True) == Done(refusal=why)
    assert sender.plant == P
    assert sender.record == RECORD


def test_a_hello_to_anyone_is_greeted() -> None:
    said = at_work().heard_plant(hello(controller=None, session=NEW))
    assert said == Done(reply=reply("greeting", answers=None))


def test_journals_that_do_not_fit_together() -> None:
    for applied_k in (1, 3):
        sender = controller(RECORD)
        said = sender.heard_plant(hello(transitions=2, applied_k=applied_k))
        assert said == Done(reply=reply("accepted"))
        assert sender.record == RECORD
    for applied_k in (0, 2, 4):
        said = controller(RECORD).heard_plant(hello(transitions=2, applied_k=applied_k))
        assert said == Done(
            reply=reply("unknown-session"), refusal="the journals do not fit together"
        )
    unanswered = controller(changed(RECORD, offer=None))
    assert unanswered.heard_plant(hello(transitions=2, applied_k=3)).refusal
    assert not unanswered.heard_plant(hello(transitions=2, applied_k=1)).refusal


@pytest.mark.parametrize("fields", [{"session": NEW, "transitions": 1}, {"session": T}])
def test_a_session_of_another_journal(fields: dict[str, object]) -> None:
    said = controller(RECORD).heard_plant(hello(**fields))
    assert said == Done(
        reply=reply("unknown-session", session=fields["session"]),
        refusal="the plant is in a session this journal does not know",
    )


def test_a_new_session_ends_the_one_before_and_begins_the_message_again() -> None:
    sender = controller(RECORD)
    said = sender.heard_plant(hello(session=NEW))
    assert said == Done(save=True, reply=reply("accepted", session=NEW))
    assert sender.plant == P
    assert sender.record == changed(OVER, session=NEW)


def test_so_many_sessions_are_remembered() -> None:
    sender = controller()
    sessions = [f"{i:016x}" for i in range(REMEMBERED_SESSIONS + 5)]
    for session in sessions:
        assert sender.heard_plant(hello(session=session)).save
    assert sender.record.session.ended == tuple(sessions[4:-1])
    assert len(sender.record.session.ended) == REMEMBERED_SESSIONS


def test_who_is_asked_for_another_steps_back() -> None:
    why = f"plant {P} is with controller {B}, and not with this one, {A}"
    sender = at_work()
    overtaken = sender.heard_plant(hello(controller=B, transitions=2, applied_k=1))
    assert overtaken == Done(save=True, refusal=why)
    assert sender.plant is None
    assert sender.record == OVER
    sender = at_work()
    assert sender.heard_plant(hello(controller=B, session=NEW)) == Done(refusal=why)
    assert sender.plant is None
    assert sender.record == RECORD
    # it does not ask which session that is, as it knows; it asks of any other
    assert sender.measured(measurement(session=NEW)) == NOTHING
    assert sender.measured(measurement(session=T)) == Done(reply=sender.greeting())
    # asked again, or anyone being asked, it speaks up once more
    sender.heard_plant(hello(controller=None, session=NEW))
    assert sender.measured(measurement(session=NEW)) == Done(reply=sender.greeting())


def test_who_never_took_it_up_keeps_its_journal_when_it_steps_back() -> None:
    sender = controller(RECORD)
    said = sender.heard_plant(hello(controller=B, transitions=2, applied_k=1))
    assert not said.save
    assert sender.record == RECORD


# --- measurements ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fields", "why"),
    [
        ({"x": (0.0, 0.0)}, "measurement.x: got 2 states, expected 1"),
        ({"x": ()}, "measurement.x: got 0 states, expected 1"),
        ({"x_after": (0.0, 0.0)}, "measurement.x_after: got 2 states, expected 1 or none"),
        ({"x": (1.1e150,)}, "measurement: got a state beyond 1e+150"),
        ({"x_after": (-1.1e150,)}, "measurement: got a state beyond 1e+150"),
    ],
)
def test_a_measurement_that_is_malformed_is_named(fields: dict[str, object], why: str) -> None:
    sender = at_work()
    with pytest.raises(ValueError) as refused:
        sender.measured(measurement(**fields))
    assert str(refused.value) == why
    assert sender.record == RECORD


def test_the_largest_state_is_still_reckoned_with() -> None:
    assert at_work().measured(measurement(x=(-1e150,))).refusal == ""


@pytest.mark.parametrize(
    "fields",
    [
        {"k": 3, "applied_k": 1, "x": (0.1,)},
        {"k": 3, "applied_k": 2},
        {"applied_k": 2},
        {"applied_k": 4},
        {"x_after": ()},
    ],
)
def test_a_measurement_that_the_journal_rules_out_ends_the_session(
    fields: dict[str, object],
) -> None:
    sender = at_work()
    told = measurement(**fields)
    assert sender.measured(told) == Done(
        save=True,
        reply=reply("greeting", session=None, answers=None),
        refusal=f"measurement {told.k} does not follow from the journal; session ended",
    )
    assert sender.record == OVER
    assert sender.plant is None


def test_so_many_measurements_of_steps_gone_by_end_the_session() -> None:
    sender = at_work()
    old = measurement(k=2, applied_k=1)
    for _ in range(2):
        for _ in range(STALE - 1):
            assert sender.measured(old) == NOTHING
        assert sender.measured(measurement(k=3, applied_k=1, x=(0.0,))).offer == OFFER
    for _ in range(STALE - 1):
        assert sender.measured(old) == NOTHING
    assert sender.measured(old).refusal == (
        "measurement 2 does not follow from the journal; session ended"
    )
    assert sender.record == OVER


def test_where_the_law_has_no_answer_the_transition_counts_all_the_same() -> None:
    sender = at_work()
    effects = sender.measured(measurement(x=(101.0,)))
    assert effects.save
    assert effects.offer is None
    assert not effects.append
    assert effects.refusal == "no answer at 101"
    assert effects.transition is not None
    assert sender.record.link.transitions == 3
    assert (sender.record.link.k, sender.record.link.applied_k) == (4, 3)
    assert (sender.record.link.x, sender.record.offer) == ((101.0,), None)


def test_where_the_law_has_no_answer_the_row_of_the_transition_is_saved() -> None:
    """A process that dies there would make another key block than the plant."""
    rules = replace(RULES, schedule=Schedule(Assumption(0.95, eps_sec=1e-2), 2, 4))
    row = Contribution(1, 1, b"n" * 32, None)
    sender = ControllerInHand(
        rules, propose, A, changed(RECORD, incarnation=0), contributions=[row]
    )
    sender.heard_plant(hello(transitions=2, applied_k=1))
    counted = sender.measured(measurement(x=(101.0,)))
    assert counted.save
    assert [row.j for row in counted.rows] == [2]


def test_a_difference_of_key_blocks_ends_the_session() -> None:
    sender = ControllerInHand(
        replace(RULES, schedule=Schedule(Assumption(0.95, eps_sec=1e-2), 2, 4)),
        propose,
        A,
        changed(RECORD, incarnation=0, transitions=3),
        contributions=[Contribution(j, 1, b"n" * 32, b"m" * 32) for j in (1, 2)],
    )
    gathered(sender.core.start(0.0))
    sender.heard_plant(hello(transitions=3, applied_k=1))
    gathered(sender.core.extracted(ExtractedBlock(S, 0, "a" * 32, (b"k" * 32,))))
    sender.measured(measurement(block=0, tag="c" * 32))
    ended = sender.finish_step()
    assert ended.blocks == (BlockEnded(S, 0, "unequal"),)
    assert ended._replace(blocks=(), transition=None) == Done(
        save=True,
        reply=GREETING,
        refusal="a key block differs from the other end's; session ended",
    )
    assert sender.record == changed(OVER, tag=NO_TAG, begun=1)
    assert sender.keys.stream.left == 0, "no key of it serves"


def test_an_answer_is_settled_before_the_next_measurement() -> None:
    sender = at_work()
    sender.measured(measurement())
    assert sender.unfinished
    with pytest.raises(AssertionError, match=r"^the step before has not been counted"):
        sender.measured(measurement(k=5))


def test_a_nonlinear_model_brings_its_predictions() -> None:
    rules = replace(RULES, predicted=True)
    sender = controller(rules=rules, predict=lambda x, u: (x[0] + 2 * u[0],))
    sender.heard_plant(hello())
    offer = sender.measured(measurement(k=0, applied_k=-1, x_after=())).offer
    assert offer is not None
    assert offer.predictions == ((3.5,), (-2.5,))
    sender = controller(rules=rules)
    sender.heard_plant(hello())
    with pytest.raises(AssertionError, match=r"^a nonlinear f_c is the controller's to bring"):
        sender.measured(measurement(k=0, applied_k=-1, x_after=()))


# --- the plant's ----------------------------------------------------------------------------------

AT_THE_PLANT = plant_record(session=S, k=3, x=(0.0,), u=(0.0,), transitions=2, controller=A)


def plant(rules: Rules = RULES) -> PlantInHand:
    return PlantInHand(rules, P, AT_THE_PLANT)


@pytest.mark.parametrize(
    ("fields", "why"),
    [
        ({"candidates": ((0.0,),)}, "offer.candidates: got 1, expected 2"),
        ({"candidates": ((0.0,),) * 3}, "offer.candidates: got 3, expected 2"),
        ({"candidates": ((0.0,), (0.0, 0.0))}, "offer.candidates: expected 1 inputs in each"),
        ({"candidates": ((0.0,), (5.1,))}, "offer.candidates: expected inputs in U"),
        ({"cipher": 2}, "offer.cipher: got 2, expected below 2"),
        ({"predictions": ((0.0,),) * 2}, "offer.predictions: expected none, as f_c is linear"),
    ],
)
def test_an_offer_that_is_malformed_is_named(fields: dict[str, object], why: str) -> None:
    with pytest.raises(ValueError) as refused:
        plant().check(OFFER.model_copy(update=fields))
    assert str(refused.value) == why


def test_an_input_outside_u_by_rounding_alone_is_admissible() -> None:
    rules = line_rules(alpha=4.0, largest_input=1.0)
    assert rules.admissible((-INSIDE,))
    assert not rules.admissible((nextafter(INSIDE, 2),))


@pytest.mark.parametrize("predictions", [(), ((0.0,),), ((0.0,),) * 3, ((0.0,), (0.0, 0.0))])
def test_predictions_of_another_shape_are_malformed(predictions: tuple[Vector, ...]) -> None:
    receiver = plant(replace(RULES, predicted=True))
    with pytest.raises(ValueError) as refused:
        receiver.check(OFFER.model_copy(update={"predictions": predictions}))
    assert str(refused.value) == "offer.predictions: expected 2 predictions of 1 states"
    right = OFFER.model_copy(update={"predictions": ((0.0,),) * 2})
    assert receiver.check(right) == "current"


@pytest.mark.parametrize(
    ("fields", "is_"),
    [({}, "current"), ({"k": 2}, "stale"), ({"k": 4}, "stale"), ({"session": T}, "foreign")],
)
def test_an_offer_is_for_one_session_and_one_step(fields: dict[str, object], is_: str) -> None:
    assert plant().check(OFFER.model_copy(update=fields)) == is_


def test_predictions_decide_where_the_model_is_not_linear() -> None:
    gauge = Gauge(half_widths=(1.0,))
    rule = AgreementRule(A=((1.0,),), B=((1.0,),), gauge=gauge, alpha=9.0)
    for predicted, gauges in ((True, (1.0, 4.0)), (False, (0.5, 3.5))):
        rules = replace(RULES, agreement=rule, predicted=predicted)
        verdict = rules.judge((0.0,), CANDIDATES, ((3.0,), (-2.0,)), (2.0,))
        assert verdict.gauges == gauges


def test_a_session_that_the_controller_does_not_know_begins_anew() -> None:
    receiver = plant()
    assert receiver.heard_controller(reply("greeting", session=None), NEW) == "nothing"
    receiver.look_around()
    assert receiver.heard_controller(reply("greeting", session=None), NEW) == "greet"
    assert receiver.controller == A
    assert receiver.heard_controller(reply("unknown-session"), NEW) == "ended"
    assert not receiver.accepted
    assert receiver.record == plant_record(
        session=NEW,
        k=3,
        x=(0.0,),
        u=(0.0,),
        state=Switched(2).initial,
        sessions=2,
        controller=A,
        incarnation=1,
    )
    assert receiver.hello() == hello(session=NEW)


def test_a_difference_of_key_blocks_begins_a_session() -> None:
    keys = replace(RULES, schedule=Schedule(Assumption(0.95, eps_sec=1e-2), 2, 4))
    receiver = PlantInHand(keys, P, changed(AT_THE_PLANT, transitions=0))
    receiver.look_around()
    receiver.heard_controller(reply("greeting"), NEW)
    assert receiver.heard_controller(reply("accepted"), NEW) == "accepted"
    for k in (3, 4, 5):
        receiver.applied(OFFER.model_copy(update={"k": k, "nonce": fresh_nonce()}), 0, (1.5,))
    receiver.carry_out(receiver.core.extracted(ExtractedBlock(S, 0, "a" * 32, (b"k" * 32,))))
    differs = {"k": 6, "nonce": fresh_nonce(), "block": 0, "tag": "c" * 32}
    receiver.applied(OFFER.model_copy(update=differs), 0, (1.5,))
    assert not receiver.accepted
    assert (receiver.record.session.id, receiver.record.session.sessions) == (NEW, 2)
    assert BlockEnded(S, 0, "unequal") in receiver.events


@pytest.mark.parametrize("record", [AT_THE_PLANT, changed(AT_THE_PLANT, transitions=0, sessions=2)])
def test_who_has_met_its_controller_takes_another_models_for_a_stranger(
    record: PlantRecord,
) -> None:
    receiver = PlantInHand(RULES, P, record)
    assert receiver.heard_controller(reply("greeting", fingerprint=OTHER), NEW) == "incompatible"
    assert not receiver.refused


@pytest.mark.parametrize(("flipped", "refused"), [(0, 0), (1, 1)])
def test_a_frame_whose_check_fails_counts_as_refused(flipped: int, refused: int) -> None:
    *symbols, last = encode_frame(b"a", 2)
    record = changed(
        AT_THE_PLANT, state=(2, 0), partial="".join(map(str, symbols)), messages=3, frames_refused=5
    )
    receiver = PlantInHand(RULES, P, record)
    counted = receiver.applied(OFFER.model_copy(update={"cipher": last ^ flipped}), 0, (1.5,))
    (saved,) = receiver.saved
    assert saved.received == (None if refused else b"a")
    assert (counted.recovered, counted.refused) == (saved.received, bool(refused))
    after = receiver.record
    assert (after.frame.messages, after.frame.refused) == (4 - refused, 5 + refused)
    assert (after.frame.partial, after.frame.stored, saved.symbols) == ("", 0, "")
    assert not receiver.deframer.symbols


def test_in_a_new_session_no_copy_of_the_step_under_way_is_the_first() -> None:
    """That of the session before may have left with the nonce of this step."""
    keys = replace(RULES, schedule=Schedule(Assumption(0.95, eps_sec=1e-2), 2, 4))
    receiver = PlantInHand(keys, P, AT_THE_PLANT)
    assert receiver.heard_controller(reply("greeting"), NEW) == "greet"
    receiver.missed((0.0,), (0.0,))
    nonce = receiver.record.link.nonce
    assert receiver.heard_controller(reply("unknown-session"), NEW) == "ended"
    assert receiver.heard_controller(reply("accepted", session=NEW), NEW) == "accepted"
    for _ in range(2):
        said = receiver.measurement()
        assert said.copy_number == 1
        assert len(said.nonce) == 44
        assert said.nonce != nonce
    receiver.missed((0.0,), (0.0,))
    assert receiver.measurement().copy_number == 0
