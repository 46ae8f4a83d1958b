"""What an end reports beside its record: the first messages of a life, statuses, notices."""

from dataclasses import replace
from typing import Literal

import pytest

from controller_service.core import ControllerCore
from plant_service.status import PlantTelemetry
from protocol.link.events import Missed, Timing
from protocol.link.records import INITIAL_ID, ControllerRecord, Loaded
from protocol.link.session import Rules, Truth
from protocol.messages import (
    ControllerHello,
    Measurement,
    Message,
    Offer,
    PlantHello,
    PlantStatus,
    SendCommand,
)
from protocol.scenario import Scenario
from protocol.schemes.framing import encode_frame
from runtime.journal import ControllerJournal
from tests.support.asked import Asked, gathered, turns
from tests.support.controller_in_hand import PERIOD_S, Zeros
from tests.support.journals import controller_journal
from tests.support.line_ends import line_rules
from tests.support.plant_in_hand import STEP_S, PlantInHand, ScriptedLine
from tests.support.records import changed, controller_record, plant_record

RULES = line_rules(alpha=4.0, largest_input=5.0)
HALTING = replace(RULES, halts=True)
S, P, A, NEW = "1" * 16, "c" * 16, "a" * 16, "9" * 16
CANDIDATES = ((1.5,), (-1.5,))
REPORTED = Measurement(session=S, k=4, x=(0.0,), applied_k=2, x_after=(0.0,))
OFFER = Offer(session=S, k=3, candidates=CANDIDATES, cipher=0)

# --- the controller's -----------------------------------------------------------------------------


def controller(
    journal: ControllerJournal,
    message: bytes | None = None,
    record: ControllerRecord | None = None,
    rules: Rules = RULES,
) -> ControllerCore:
    return ControllerCore(
        rules,
        lambda x: CANDIDATES,
        journal,
        Zeros(),
        instance=A,
        period_s=PERIOD_S,
        loaded=Loaded(record),
        message=message,
    )


def first_words(core: ControllerCore) -> list[Asked]:
    """All that a life begins with."""
    return [*turns(core.start(0.0))]


def queued(said: list[Asked]) -> list[SendCommand]:
    saves = [asked.save for asked in said if asked.save is not None]
    return [save.queued for save in saves if save.queued is not None]


def test_a_controller_queues_the_message_that_it_is_started_with_once_and_then_greets() -> None:
    journal = controller_journal()
    said = first_words(controller(journal, b"hi"))
    command = SendCommand(id=INITIAL_ID, payload=b"hi")
    assert queued(said) == [command]
    assert said[0].events == (command,)
    assert [type(message) for asked in said for message in asked.publish] == [ControllerHello]
    for asked in said:
        if asked.save is not None:
            journal.save(asked.save)
    again = first_words(controller(journal, b"hi", journal.load().record))
    assert queued(again) == []
    assert [type(message) for message in again[-1].publish] == [ControllerHello]


@pytest.mark.parametrize("halted", [False, True])
def test_a_life_begins_with_a_refusal_only_where_an_alarm_has_ended_the_offers(
    halted: bool,
) -> None:
    record = controller_record(halted=halted)
    said = first_words(controller(controller_journal(), None, record, HALTING))
    assert [n.subject for asked in said for n in asked.notices] == ["refusals"] * halted


def test_a_controller_that_was_halted_offers_nothing_more_in_its_next_life() -> None:
    record = controller_record(session=S, k=3, applied_k=2, x=(0.0,), transitions=3, offer=None)
    hello = PlantHello(
        instance=P,
        session=S,
        controller=A,
        incarnation=1,
        fingerprint=RULES.fingerprint,
        transitions=3,
        applied_k=2,
    )

    def offers(core: ControllerCore) -> bool:
        first_words(core)
        gathered(core.receive(PlantHello, hello.wire(), 1.0))
        asked = gathered(core.receive(Measurement, REPORTED.wire(), 2.0))
        return any(isinstance(message, Offer) for message in asked.publish)

    assert offers(controller(controller_journal(), None, record, HALTING))
    kept = changed(record, halted=True)
    assert not offers(controller(controller_journal(), None, kept, HALTING))


# --- the plant's ----------------------------------------------------------------------------------

AT_THE_PLANT = plant_record(session=S, k=3, x=(0.0,), u=(0.0,), transitions=2, controller=A)


class Jammed(ScriptedLine):
    """A plant that cannot be closed."""

    def close(self) -> str:
        return "the valve does not move"


@pytest.fixture
def news(sustained: Scenario) -> PlantTelemetry:
    """Its figures are the record's; of the scenario it shows the names."""
    return PlantTelemetry.of(sustained, "realtime", seeded=False)


def answer(verdict: Literal["greeting", "accepted", "unknown-session"]) -> ControllerHello:
    """What the controller says to the plant's hello."""
    return ControllerHello(
        instance=A,
        incarnation=1,
        fingerprint=RULES.fingerprint,
        verdict=verdict,
        session=S,
        answers=P,
    )


def met(receiver: PlantInHand) -> PlantInHand:
    """A plant whose session a controller has taken up."""
    receiver.heard_controller(answer("greeting"), NEW)
    assert receiver.heard_controller(answer("accepted"), NEW) == "accepted"
    return receiver


def status(receiver: PlantInHand) -> PlantStatus:
    """Its next one."""
    receiver.published.clear()
    while (told := receiver.said(PlantStatus)) is None:
        receiver.carry_out(receiver.core.wake(receiver.core.wake_at()))
    assert isinstance(told, PlantStatus)
    return told


@pytest.mark.parametrize(
    ("kind", "name"),
    [(Offer, "offer"), (ControllerHello, "management/controller/hello")],
)
def test_what_is_malformed_is_named_and_counted_from_none_on(
    kind: type[Message], name: str, news: PlantTelemetry
) -> None:
    receiver = met(PlantInHand(RULES, P, AT_THE_PLANT, news=news))
    assert status(receiver).malformed == 0
    receiver.hear(kind, b'{"session":1}')
    (line,) = receiver.notices
    assert (line.subject, line.text.split(":")[0]) == ("malformed", name)
    assert status(receiver).malformed == 1


def test_a_status_of_a_message_that_came_through_is_due_at_once(news: PlantTelemetry) -> None:
    *symbols, last = encode_frame(b"a", 2)
    record = changed(AT_THE_PLANT, state=(2, 0), partial="".join(map(str, symbols)))
    receiver = met(PlantInHand(RULES, P, record, news=news))
    before = status(receiver)
    assert (before.message_k, before.frame_symbols) == (-1, len(symbols))
    receiver.line.x_next = (1.5,)
    receiver.hear(Offer, OFFER.model_copy(update={"cipher": last}).wire())
    assert receiver.core.wake_at() == receiver.core.state.now
    told = status(receiver)
    assert (told.last_message, told.message_k, told.frame_symbols) == ("a", 3, 0)
    assert (told.k, told.messages) == (4, 1)


def test_a_session_that_ends_is_a_warning_and_names_the_next() -> None:
    receiver = met(PlantInHand(RULES, P, AT_THE_PLANT))
    assert receiver.heard_controller(answer("unknown-session"), NEW) == "ended"
    (line,) = receiver.notices
    assert line.level == "warning"
    assert NEW in line.text


def test_a_plant_that_stops_tells_how_punctual_it_was(news: PlantTelemetry) -> None:
    receiver = met(PlantInHand(RULES, P, AT_THE_PLANT, news=news))
    receiver.missed((0.0,), (0.0,))
    receiver.carry_out(receiver.core.wake(receiver.core.state.pacing.deadline + STEP_S / 4))
    stopped = gathered(receiver.core.stop(2 * STEP_S))
    assert stopped.events == (Timing(5, 2, (0.0, STEP_S / 4, STEP_S / 4), (), 0),)
    (told,) = [message for message in stopped.publish if isinstance(message, PlantStatus)]
    assert (told.phase, told.k) == ("stopped", 5)
    assert gathered(PlantInHand(RULES, P, AT_THE_PLANT).core.stop(0.0)).events == ()


def test_a_missed_step_is_told_with_what_it_really_came_to() -> None:
    line = ScriptedLine()
    line.truth = Truth((7.0,), (8.0,))
    receiver = met(PlantInHand(RULES, P, AT_THE_PLANT, plant=line))
    receiver.line.x_next = line.x_next = line.fallback = (0.0,)
    receiver.missed((0.0,), (0.0,))
    (missed,) = [event for event in receiver.events if isinstance(event, Missed)]
    assert missed.truth == line.truth


def test_a_plant_that_cannot_be_closed_says_why() -> None:
    assert gathered(PlantInHand(RULES, P, AT_THE_PLANT).core.stop(0.0)).notices == ()
    jammed = PlantInHand(RULES, P, AT_THE_PLANT, plant=Jammed())
    (line,) = gathered(jammed.core.stop(0.0)).notices
    assert (line.level, line.text) == ("error", "the valve does not move")
