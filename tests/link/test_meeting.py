"""How the two ends find each other, and what third parties and lost journals do to them."""

import pytest
from pydantic import ValidationError

from controller_service.chooser import STALE
from protocol.link.records import ControllerRecord, PlantRecord
from protocol.link.step import Read
from protocol.messages import LARGEST_COUNT, ControllerHello, Measurement, Offer, PlantHello
from tests.support.controller_in_hand import NOTHING, ControllerInHand, Done, OneMessage
from tests.support.line_ends import line_rules
from tests.support.plant_in_hand import PlantInHand
from tests.support.records import plant_record

RULES = line_rules(alpha=4.0, largest_input=5.0)
OTHER = "e" * 64
A, B, P, Q = (letter * 16 for letter in "abcd")
NEW = "2" * 16


def controller(
    instance: str, record: ControllerRecord | None = None, payload: bytes = b"hello"
) -> ControllerInHand:
    def propose(x: tuple[float, ...]) -> tuple[tuple[float, ...], ...]:
        return ((1.5 - x[0],), (-1.5 - x[0],))

    return ControllerInHand(RULES, propose, instance, record, messages=OneMessage(payload))


def plant(instance: str, record: PlantRecord | None = None, chunks: str = "") -> PlantInHand:
    first = plant_record(session="1" * 16, k=0, x=(0.0,), u=(0.0,))
    return PlantInHand(RULES, instance, record or first, chunks)


def meet(sender: ControllerInHand, receiver: PlantInHand) -> None:
    said: ControllerHello | None = sender.greeting()
    for _ in range(4):
        assert said is not None
        if (
            receiver.heard_controller(said, f"{receiver.record.session.sessions + 1:016x}")
            == "accepted"
        ):
            return
        said = sender.heard_plant(receiver.hello()).reply
    raise AssertionError("they did not meet")


def answer(sender: ControllerInHand, measurement: Measurement) -> Offer:
    effects = sender.measured(measurement)
    if effects.append:
        sender.finish_step()
    assert effects.offer is not None
    return effects.offer


def step(sender: ControllerInHand, receiver: PlantInHand, d: float = 0.5) -> Offer:
    """A step that agrees on a key where it is tested."""
    offer = answer(sender, receiver.measurement())
    assert receiver.check(offer) == "current"
    x = receiver.record.link.x[0] + offer.candidates[1][0] + d
    receiver.applied(offer, 1, (x,))
    return offer


def met(steps: int = 0) -> tuple[ControllerInHand, PlantInHand]:
    sender, receiver = controller(A), plant(P)
    meet(sender, receiver)
    for i in range(steps):
        step(sender, receiver, 0.5 if i % 2 else -0.5)
    return sender, receiver


# --- hellos ---------------------------------------------------------------------------------------


def test_a_plant_asks_whoever_greets_first_and_no_other() -> None:
    receiver = plant(P)
    assert receiver.hello().controller is None
    assert receiver.heard_controller(controller(A).greeting(), NEW) == "greet"
    assert receiver.hello().controller == A
    assert receiver.heard_controller(controller(B).greeting(), NEW) == "competing"
    assert receiver.hello().controller == A
    assert not receiver.accepted


def test_a_controller_takes_up_no_session_that_is_not_offered_to_it() -> None:
    """Were two controllers in one session, a key symbol would meet two cipher symbols."""
    sender, receiver = controller(B), plant(P)
    reply = sender.heard_plant(receiver.hello()).reply
    assert reply is not None
    assert reply.verdict == "greeting"
    receiver.heard_controller(controller(A).greeting(), NEW)
    effects = sender.heard_plant(receiver.hello())
    assert effects.reply is None
    assert A in effects.refusal
    assert B in effects.refusal
    assert sender.record.session.id is None
    assert sender.measured(receiver.measurement()) == NOTHING


def test_a_session_is_handed_to_another_controller_only_with_its_journal() -> None:
    first, receiver = met()
    receiver.look_around()
    assert receiver.heard_controller(controller(B).greeting(), NEW) == "ended"
    assert receiver.record.session.id == NEW != first.record.session.id
    assert receiver.hello().controller == B

    first, receiver = met()
    again = controller(B, first.record)
    assert receiver.heard_controller(again.greeting(), NEW) == "greet"
    assert receiver.record.session.id == first.record.session.id


def test_a_session_is_not_handed_on_after_a_restart_of_the_plant() -> None:
    receiver = met()[1]
    receiver = plant(Q, receiver.record)
    assert receiver.heard_controller(controller(B).greeting(), NEW) == "ended"
    assert receiver.record.session.id == NEW


def test_a_controller_that_comes_back_with_its_journal_goes_on_at_once() -> None:
    sender, receiver = met(5)
    again = controller(B, sender.record)
    meet(again, receiver)
    assert receiver.record.session.sessions == 1
    step(again, receiver)


def test_a_controller_without_the_journal_waits_until_the_other_one_is_silent() -> None:
    sender, receiver = met(5)
    second = controller(B)
    assert receiver.heard_controller(second.greeting(), NEW) == "competing"
    second.heard_plant(receiver.hello())
    step(sender, receiver)
    receiver.look_around()
    assert receiver.hello().controller is None
    reply = second.heard_plant(receiver.hello()).reply
    assert reply is not None
    assert receiver.heard_controller(reply, NEW) == "greet"
    meet(second, receiver)
    assert receiver.record.session.sessions == 2
    step(second, receiver)
    # The first one thaws: it answers what it had heard, in a session that is over, and learns it.
    assert receiver.check(Offer(session=sender.record.session.id or "", k=receiver.record.link.k,
                                candidates=((0.0,), (1.0,)), cipher=0)) == "foreign"  # fmt: skip
    assert sender.heard_plant(receiver.hello()).reply is None
    assert sender.measured(receiver.measurement()).offer is None


def test_a_hello_to_a_former_life_of_the_controller_is_answered_and_ends_nothing() -> None:
    sender, receiver = met(5)
    late = receiver.hello()
    assert (late.controller, late.incarnation) == (A, 1)
    again = controller(B, sender.record)
    meet(again, receiver)
    session = again.record.session.id
    assert again.heard_plant(late) == Done(reply=again.greeting())
    assert again.record.session.id == session
    step(again, receiver)
    assert receiver.record.session.sessions == 1


@pytest.mark.parametrize("silent", [False, True])
def test_a_greeting_of_a_former_life_counts_for_nothing(silent: bool) -> None:
    sender, receiver = met(5)
    late = sender.greeting()
    again = controller(B, sender.record)
    meet(again, receiver)
    if silent:
        receiver.look_around()
    assert receiver.heard_controller(late, NEW) == "competing"
    assert receiver.controller == B
    # nor in the plant's next life
    restarted = plant(Q, receiver.record)
    assert restarted.heard_controller(late, NEW) == "nothing"
    assert restarted.hello().controller is None
    meet(again, restarted)
    assert restarted.record.session.sessions == 1


def test_a_journal_put_back_counts_its_lives_on_from_what_the_plant_knows() -> None:
    sender, receiver = met(5)
    kept = sender.record
    for instance in (B, Q):
        sender = controller(instance, sender.record)
        meet(sender, receiver)
    back = controller("9" * 16, kept)
    assert (back.record.session.incarnation, receiver.record.session.incarnation) == (2, 3)
    assert receiver.heard_controller(back.greeting(), NEW) == "competing"
    receiver.look_around()
    effects = back.heard_plant(receiver.hello())
    assert effects.save
    assert back.record.session.incarnation == 4
    meet(back, receiver)
    # the one that went on from the newer journal learns that the session is not its own any more
    assert sender.heard_plant(receiver.hello()).save
    assert sender.record.session.id is None


def test_lives_are_not_counted_beyond_what_a_hello_can_say() -> None:
    sender, receiver = met(2)
    asked = receiver.hello().model_copy(update={"controller": None, "incarnation": LARGEST_COUNT})
    reply = sender.heard_plant(asked).reply
    assert reply is not None
    assert reply.incarnation == LARGEST_COUNT
    assert controller(B, sender.record).greeting().incarnation == LARGEST_COUNT


def test_who_is_overtaken_offers_nothing_more_in_that_session() -> None:
    sender, receiver = met(5)
    twin = controller(B, sender.record, payload=b"another")
    meet(twin, receiver)
    effects = sender.heard_plant(receiver.hello())
    assert effects.save
    assert sender.record.session.id is None
    assert sender.measured(receiver.measurement()) == NOTHING


def test_the_one_asked_answers_again_and_ends_the_search() -> None:
    sender, receiver = met(3)
    receiver.look_around()
    reply = sender.heard_plant(receiver.hello()).reply
    assert reply is not None
    assert receiver.heard_controller(reply, NEW) == "greet"
    assert receiver.accepted
    assert receiver.hello().controller == A
    receiver.look_around()
    step(sender, receiver)
    assert receiver.hello().controller == A


def test_an_answer_of_one_that_was_not_asked_counts_for_nothing() -> None:
    sender, receiver = met(1)
    hello = receiver.hello()
    reply = sender.heard_plant(hello).reply
    assert reply is not None
    for verdict in ("accepted", "unknown-session"):
        stray = reply.model_copy(update={"instance": B, "verdict": verdict})
        assert receiver.heard_controller(stray, NEW) == "competing"
    assert receiver.record.session.sessions == 1
    assert receiver.controller == A


@pytest.mark.parametrize("late", ["same step", "steps ago"])
def test_a_hello_that_was_overtaken_ends_nothing(late: str) -> None:
    sender, receiver = controller(A), plant(P)
    assert receiver.heard_controller(sender.greeting(), NEW) == "greet"
    repeat = receiver.hello()
    meet(sender, receiver)
    for _ in range(3 if late == "steps ago" else 1):
        step(sender, receiver)
    answer(sender, receiver.measurement())
    session = sender.record.session.id
    assert sender.heard_plant(repeat) == NOTHING
    step(sender, receiver)
    assert sender.record.session.id == session


def test_a_hello_of_a_session_that_is_over_brings_nothing_back() -> None:
    sender, receiver = met(3)
    old = receiver.hello()
    sender = controller(B)
    receiver.look_around()
    meet(sender, receiver)
    step(sender, receiver)
    session = sender.record.session.id
    # for its own predecessor, and for itself
    for whom in (A, B):
        effects = sender.heard_plant(old.model_copy(update={"controller": whom}))
        if effects.reply is not None:
            assert receiver.heard_controller(effects.reply, NEW) == "nothing"
    meet(sender, receiver)
    step(sender, receiver)
    assert sender.record.session.id == session == receiver.record.session.id


def test_a_hello_of_its_own_ended_session_is_answered_and_changes_nothing() -> None:
    sender, receiver = met()
    old = receiver.hello()
    forged = receiver.measurement().model_copy(update={"applied_k": 7, "x_after": (0.0,)})
    assert sender.measured(forged).reply
    meet(sender, receiver)
    step(sender, receiver)
    record = sender.record
    reply = sender.heard_plant(old).reply
    assert reply is not None
    assert reply.verdict == "unknown-session"
    assert receiver.heard_controller(reply, NEW) == "nothing"
    assert sender.record == record
    step(sender, receiver)


# --- strangers ------------------------------------------------------------------------------------


def test_a_plant_of_another_model_is_told_so_and_the_pair_goes_on() -> None:
    sender, receiver = met(2)
    effects = sender.heard_plant(plant(Q).hello().model_copy(update={"fingerprint": OTHER}))
    assert effects.reply is not None
    assert effects.reply.verdict == "other-model"
    assert Q in effects.refusal
    assert not sender.refused
    step(sender, receiver)


def test_a_controller_of_another_model_is_ignored_by_a_pair() -> None:
    sender, receiver = met(2)
    stray = controller(B).greeting().model_copy(update={"fingerprint": OTHER})
    assert receiver.heard_controller(stray, NEW) == "incompatible"
    assert not receiver.refused
    assert receiver.accepted
    step(sender, receiver)


def test_a_journal_that_has_met_its_partner_is_not_refused_after_a_restart() -> None:
    sender, receiver = met(2)
    sender, receiver = controller(B, sender.record), plant(Q, receiver.record)
    strange_plant = plant(P).hello().model_copy(update={"fingerprint": OTHER})
    strange_controller = controller(A).greeting().model_copy(update={"fingerprint": OTHER})
    sender.heard_plant(strange_plant)
    assert receiver.heard_controller(strange_controller, NEW) == "incompatible"
    assert not sender.refused
    assert not receiver.refused
    meet(sender, receiver)


def test_with_nobody_else_there_another_model_is_the_end() -> None:
    sender, receiver = controller(A), plant(P)
    hello = receiver.hello()
    assert receiver.heard_controller(
        sender.greeting().model_copy(update={"fingerprint": OTHER}), NEW
    ) == "refused"  # fmt: skip
    sender.heard_plant(hello.model_copy(update={"fingerprint": OTHER}))
    assert sender.refused
    assert receiver.refused


def test_a_second_plant_waits_while_the_first_one_runs() -> None:
    sender, receiver = met(2)
    second = plant(Q, plant_record(session=NEW, k=0, x=(0.0,), u=(0.0,)))
    effects = sender.heard_plant(second.hello(), running=True)
    assert effects.reply is None
    assert P in effects.refusal
    assert Q in effects.refusal
    step(sender, receiver)
    reply = sender.heard_plant(second.hello(), running=False).reply
    assert reply is not None
    second.heard_controller(reply, NEW)
    meet(sender, second)
    step(sender, second)


def test_a_plant_that_comes_back_does_not_wait() -> None:
    sender, receiver = met(2)
    again = plant(Q, receiver.record)
    reply = sender.heard_plant(again.hello(), running=True).reply
    assert reply is not None
    assert again.heard_controller(reply, NEW) == "greet"
    reply = sender.heard_plant(again.hello(), running=True).reply
    assert reply is not None
    assert again.heard_controller(reply, NEW) == "accepted"


@pytest.mark.parametrize("fingerprint", ["", "xyz", "f" * 63, "F" * 64, "f" * 64 + "\n"])
def test_a_fingerprint_is_64_hexadecimal_digits(fingerprint: str) -> None:
    with pytest.raises(ValidationError, match="fingerprint"):
        PlantHello(
            instance=A,
            session=A,
            incarnation=1,
            fingerprint=fingerprint,
            transitions=0,
            applied_k=-1,
        )
    with pytest.raises(ValidationError, match="fingerprint"):
        ControllerHello(instance=A, incarnation=1, fingerprint=fingerprint, verdict="greeting")


# --- numbers --------------------------------------------------------------------------------------


@pytest.mark.parametrize("u", [5.0, -5.0, 5.0 * (1 + 1e-12)])
def test_a_candidate_on_the_edge_of_u_is_taken(u: float) -> None:
    receiver = plant(P)
    offer = Offer(session="1" * 16, k=0, candidates=((u,), (0.0,)), cipher=0)
    assert receiver.check(offer) == "current"


@pytest.mark.parametrize("u", [5.001, -1e9, 1.7e308])
def test_a_candidate_outside_u_is_malformed(u: float) -> None:
    receiver = plant(P)
    for candidates in (((u,), (0.0,)), ((0.0,), (u,))):
        with pytest.raises(ValueError, match="inputs in U"):
            receiver.check(Offer(session="1" * 16, k=0, candidates=candidates, cipher=0))


@pytest.mark.parametrize("number", [1.1e150, -1.7e308])
def test_a_measurement_too_large_to_reckon_with_is_malformed(number: float) -> None:
    sender, receiver = met()
    offer = answer(sender, receiver.measurement())
    before = sender.record
    step = receiver.dies_over(offer, 0, (0.5,)).step
    assert isinstance(step, Read)
    true = step.report
    for change in ({"x": (number,)}, {"x_after": (number,)}):
        with pytest.raises(ValueError, match="beyond 1e"):
            sender.measured(true.model_copy(update=change))
    assert sender.record == before
    assert not sender.unfinished


@pytest.mark.parametrize(("x", "x_after", "field"), [
    ((0.0, 0.0), (), "measurement.x:"),
    ((0.0,), (0.0, 0.0), "measurement.x_after:"),
])  # fmt: skip
def test_a_vector_of_a_wrong_length_is_named(
    x: tuple[float, ...], x_after: tuple[float, ...], field: str
) -> None:
    sender, receiver = met(1)
    wrong = receiver.measurement().model_copy(update={"x": x, "x_after": x_after})
    with pytest.raises(ValueError, match=f"^{field} got 2"):
        sender.measured(wrong)


# --- journals that do not fit ---------------------------------------------------------------------


def back_in_session(sender: ControllerInHand, receiver: PlantInHand, sessions: int) -> None:
    """The two find together again, in that many sessions in all, and the message arrives."""
    meet(sender, receiver)
    assert receiver.record.session.sessions == sessions
    for i in range(300):
        step(sender, receiver, 0.5 if i % 2 else -0.5)
        if receiver.record.frame.messages or receiver.record.frame.refused:
            break
    assert (receiver.record.frame.messages, receiver.record.frame.refused) == (1, 0)


@pytest.mark.parametrize("change", [
    {"x": (0.25,)},
    {"applied_k": 7, "x_after": (0.0,)},
])  # fmt: skip
def test_a_plant_that_says_something_else_at_the_same_step_ends_the_session(
    change: dict[str, object],
) -> None:
    sender, receiver = met(4)
    measurement = receiver.measurement()
    answer(sender, measurement)
    effects = sender.measured(measurement.model_copy(update=change))
    assert effects.save
    assert effects.reply == sender.greeting()
    assert effects.offer is None
    assert sender.record.session.id is None
    back_in_session(sender, receiver, 2)


@pytest.mark.parametrize("change", [{"applied_k": 1}, {"applied_k": 7}, {"x_after": ()}])
def test_a_report_of_an_offer_that_was_not_made_ends_the_session(
    change: dict[str, object],
) -> None:
    sender, receiver = met(4)
    effects = sender.measured(receiver.measurement().model_copy(update=change))
    assert effects.save
    assert effects.offer is None
    assert not sender.unfinished
    assert sender.record.session.id is None
    back_in_session(sender, receiver, 2)


@pytest.mark.parametrize("behind", [2, 3, 30])
def test_a_controllers_journal_that_went_back_in_time_ends_the_session(behind: int) -> None:
    sender, receiver = met(10)
    old = sender.record
    for _ in range(behind):
        step(sender, receiver)
    back_in_session(controller(B, old), receiver, 2)


@pytest.mark.parametrize("behind", [1, 2, 30])
def test_a_plants_journal_that_went_back_in_time_ends_the_session(behind: int) -> None:
    sender, receiver = met(10)
    old = receiver.record
    for _ in range(behind):
        step(sender, receiver)
    answer(sender, receiver.measurement())
    back_in_session(sender, plant(Q, old), 2)


def test_a_new_session_drops_the_frame_under_way_from_the_record() -> None:
    receiver = met(60)[1]
    assert receiver.record.frame.partial
    forgetful = controller(B)
    receiver.look_around()
    meet(forgetful, receiver)
    assert receiver.record.frame.partial == ""
    for i in range(9):
        step(forgetful, receiver, 0.5 if i % 2 else -0.5)
    back_in_session(forgetful, plant(Q, receiver.record), 2)


def far_ahead(measurement: Measurement) -> Measurement:
    return measurement.model_copy(update={"k": 10**18})


@pytest.mark.parametrize("pace", ["deadlines", "lock-step"])
def test_a_step_that_was_never_made_is_forgotten_after_a_while(pace: str) -> None:
    sender, receiver = met(4)
    answer(sender, far_ahead(receiver.measurement()))
    for i in range(STALE):
        effects = sender.measured(receiver.measurement())
        assert effects.offer is None
        if pace == "deadlines":
            receiver.missed((0.0,), (0.0,))
        assert bool(effects.refusal) == (i == STALE - 1)
    back_in_session(sender, receiver, 2)


def test_repeats_from_before_end_nothing_while_newer_ones_come_between() -> None:
    sender, receiver = met(1)
    old = receiver.measurement()
    for _ in range(3):
        step(sender, receiver)
        answer(sender, receiver.measurement())
        for _ in range(STALE - 1):
            assert sender.measured(old) == NOTHING
    assert sender.record.session.id == receiver.record.session.id
