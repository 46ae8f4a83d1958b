"""All that a controller tells: each status field by field, each notice by level and subject."""

from collections.abc import Sequence
from dataclasses import replace
from math import inf
from typing import Any

import pytest

from controller_service.chooser import STALE, STALE_S
from controller_service.core import ControllerCore
from controller_service.telemetry import ControllerTelemetry
from protocol.defence.alarm_rule import AlarmRule
from protocol.link.controller_session import GREETING_S
from protocol.link.distiller import BlockEnded
from protocol.link.effects import Notice, Save
from protocol.link.events import FELL_BACK, Alarm, PowerFailed, SessionBegan
from protocol.link.key_events import Appearances
from protocol.link.pacing import HEALTH_S, STATUS_S, next_turn, phase_of
from protocol.link.records import ControllerRecord, Loaded
from protocol.link.session import CountedTransition, Rules
from protocol.link.step import IDLE, Answered, Step
from protocol.messages import (
    ControllerHello,
    ControllerStatus,
    Measurement,
    Offer,
    PlantHello,
    SendCommand,
    StopKeys,
)
from protocol.schemes.framing import encode_frame, frame_length
from protocol.schemes.sealed import Sealed
from protocol.secret.blocks import ExtractedBlock, Schedule
from protocol.secret.bound import Assumption
from protocol.secret.key_digits import digits
from protocol.secret.nonces import Contribution
from protocol.secret.stream import NOTHING_HELD, BlockKeys, Held, Part
from protocol.vectors import Vector
from runtime.chance import fresh_nonce
from runtime.errors import USAGE
from tests.support.asked import NOTHING, Asked, gathered
from tests.support.end_in_hand import EndInHand, Zeros, fields, status_of, unsaid
from tests.support.journals import controller_journal
from tests.support.line import line_rules
from tests.support.records import changed, controller_record

RULES = line_rules(alpha=4.0, largest_input=5.0)
SCHEDULE = Schedule(Assumption(0.95, eps_sec=1e-2), 2, 4)
KEYS = replace(RULES, schedule=SCHEDULE)
S, T, NEW = "1" * 16, "2" * 16, "9" * 16
A, P = "a" * 16, "c" * 16
NONCE = fresh_nonce()
CANDIDATES = ((1.5,), (-1.5,))
FAR = 100.0
OFFER = Offer(session=S, k=3, candidates=CANDIDATES, cipher=0)
AT_WORK = controller_record(
    session=S,
    incarnation=0,
    ended=(T,),
    state=RULES.scheme.initial,
    k=3,
    applied_k=1,
    transitions=2,
    agreements=1,
    p=1,
    x=(0.0,),
    offer=OFFER,
)


PERIOD_S = 0.1


class Law:
    """Sets of one state: i where |x| is at most i + 1, and none beyond 5."""

    def index(self, x: Vector) -> int:
        if abs(x[0]) > 5:
            raise LookupError("outside")
        return int(abs(x[0]))


def propose(x: Vector) -> tuple[Vector, ...]:
    if x[0] > FAR:
        raise LookupError(f"no answer at {x[0]:g}")
    return CANDIDATES


class Told(EndInHand[ControllerCore]):
    """A controller, and all that it ever did."""

    def __init__(
        self,
        rules: Rules = RULES,
        record: ControllerRecord | None = AT_WORK,
        *,
        tells: bool = True,
        status_s: float = STATUS_S,
        payloads: tuple[bytes, ...] = (),
        step: Step = IDLE,
        contributions: Sequence[Contribution] = (),
        held: Held = NOTHING_HELD,
        fell_back: bool = False,
        **more: Any,
    ) -> None:
        self.journal = controller_journal()
        for number, payload in enumerate(payloads):
            command = SendCommand(id=f"m{number}", payload=payload)
            self.journal.save(Save(controller_record(), queued=command))
        law: Any = Law()
        loaded = Loaded(record, step, tuple(contributions), held, fell_back=fell_back)
        super().__init__(
            ControllerCore(
                rules,
                propose,
                self.journal,
                Zeros(),
                instance=A,
                period_s=PERIOD_S,
                loaded=loaded,
                news=ControllerTelemetry(law, status_s) if tells else None,
                **more,
            )
        )

    def carry_out(self, asked: Asked) -> None:
        if asked.save is not None:
            self.journal.save(asked.save)

    def at_work(self, now: float = 0.0) -> "Told":
        """Its plant has asked it to take up the session of the journal."""
        self.does(self.core.start(now))
        self.hears(hello(transitions=2, applied_k=1), now)
        assert self.core.state.session.plant == P
        self.all.clear()
        return self


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


def measurement(**fields: object) -> Measurement:
    made = Measurement(session=S, k=4, x=(1.5,), applied_k=3, x_after=(1.5,))
    return made.model_copy(update=fields)


def told(actions: Asked) -> dict[str, Any]:
    """The one status that was published."""
    (status,) = actions.publish
    assert isinstance(status, ControllerStatus)
    return fields(status)


NOTHING_YET = unsaid(ControllerStatus) | {
    "phase": "greeting",
    "session": None,
    "k": -1,
    "set_index": -1,
    "transitions": 0,
    "agreements": 0,
    "malformed": 0,
    "automaton": RULES.scheme.initial[0],
    "frame_symbols": 0,
    "frame_length": 0,
    "queue": 0,
    "delivered": 0,
}


# --- when a status is due -------------------------------------------------------------------------


@pytest.mark.parametrize("status_s", [None, 0.25])
def test_statuses_come_at_turns_of_the_process_and_one_a_second_is_kept(
    status_s: float | None,
) -> None:
    more: dict[str, Any] = {} if status_s is None else {"status_s": status_s}
    end = Told(record=None, **more)
    assert end.core.wake_at() == inf, "not before it starts"
    end.does(end.core.start(5.0))
    assert end.core.wake_at() == 5.0
    assert gathered(end.core.wake(4.99)) == NOTHING
    now, last_kept, kept = 5.0, -inf, 0
    while now < 8.0:
        actions = gathered(end.core.wake(now))
        assert told(actions) == NOTHING_YET
        assert actions == Asked(publish=actions.publish, health=actions.health)
        assert (actions.health is not None) == (now >= last_kept + HEALTH_S)
        if actions.health is not None:
            assert actions.health == actions.publish[0]
            last_kept, kept = now, kept + 1
        following = next_turn(now, status_s or STATUS_S, phase_of(A))
        assert end.core.wake_at() == following
        assert gathered(end.core.wake((now + following) / 2)) == NOTHING
        now = following
    assert kept == 3


# --- what a status says ---------------------------------------------------------------------------


def test_a_status_says_what_record_rules_and_queue_hold() -> None:
    payload = b"hi"
    symbols = encode_frame(payload, 2)
    record = changed(AT_WORK, message=1, offset=3, x=(2.5,), offer=None)
    end = Told(record=record, payloads=(b"one", payload, b"three"))
    end.does(end.core.start(0.0))
    expected = NOTHING_YET | {
        "session": S,
        "k": 3,
        "set_index": 2,
        "transitions": 2,
        "agreements": 1,
        "automaton": record.link.state[0],
        "sending": "hi",
        "frame_symbols": 3,
        "frame_length": len(symbols),
        "queue": 1,
        "delivered": 1,
    }
    assert told(gathered(end.core.wake(0.0))) == expected
    assert fields(status_of(end.core)) == expected


def test_when_all_is_sent_the_last_message_is_told_as_whole() -> None:
    symbols = encode_frame(b"one", 2)
    record = changed(
        AT_WORK,
        state=(2, 1),
        cipher=1,
        message_symbol=symbols[-1],
        framed=True,
        offset=len(symbols),
    )
    end = Told(record=record, payloads=(b"one",)).at_work()
    end.hears(measurement(), 0.001)
    said = told(gathered(end.core.wake(0.001)))
    length = frame_length(3, 2)
    assert (said["sending"], said["frame_symbols"], said["frame_length"]) == ("one", length, length)
    assert (said["queue"], said["delivered"]) == (0, 1)
    assert end.journal.payload(0) is None, "it is gone from the journal"


def test_a_step_is_told_in_the_status_after_it() -> None:
    end = Told().at_work()
    before = told(gathered(end.core.wake(end.core.wake_at())))
    assert (before["phase"], before["k"]) == ("running", 3)
    end.hears(measurement(), 1.0)
    after = told(gathered(end.core.wake(end.core.wake_at())))
    assert after == before | {
        "k": 4,
        "set_index": 1,
        "transitions": 3,
        "agreements": 2,
        "automaton": end.core.state.record.link.state[0],
    }
    (transition,) = [e for actions in end.all for e in actions.events]
    assert isinstance(transition, CountedTransition)
    assert (transition.j, transition.k, transition.symbol, transition.x_next) == (2, 3, 0, (1.5,))


def test_what_no_candidate_explains_is_counted() -> None:
    end = Told(replace(RULES, alarm_rule=AlarmRule(2, 2))).at_work()
    end.hears(measurement(x=(9.0,), x_after=(9.0,)), 1.0)
    assert told(gathered(end.core.wake(end.core.wake_at())))["unexplained"] == 1
    end.hears(measurement(k=5, applied_k=4, x=(10.5,), x_after=(10.5,)), 2.0)
    assert told(gathered(end.core.wake(end.core.wake_at())))["unexplained"] == 1


def test_a_controller_whose_machine_was_started_again_counts_and_drops_the_session() -> None:
    answer = Offer(session=S, k=4, candidates=((1.5,), (-1.5,)), cipher=0)
    end = Told(step=Answered(measurement(), answer), fell_back=True)
    end.does(end.core.start(0.0))
    events = [event for actions in end.all for event in actions.events]
    assert [type(event) for event in events] == [PowerFailed, CountedTransition, SessionBegan]
    assert events[2] == SessionBegan(None, FELL_BACK)
    assert end.core.state.record.session.id is None
    assert S in end.core.state.record.session.ended
    fresh = Told(record=None, fell_back=True)
    fresh.does(fresh.core.start(0.0))
    assert [event for actions in fresh.all for event in actions.events] == [PowerFailed()]


# --- phases ---------------------------------------------------------------------------------------


def phase(end: Told) -> tuple[str, bool]:
    """The phase of its status, and whether there is a detail to it."""
    status = status_of(end.core)
    return status.phase, bool(status.detail)


def test_a_plant_where_the_law_has_no_answer_is_outside_until_it_has_one() -> None:
    end = Told().at_work()
    assert phase(end) == ("running", False)
    said = measurement(x=(101.0,), x_after=(101.0,))
    answer = gathered(end.core.receive(Measurement, said.wire(), 1.0))
    assert status_of(end.core).detail == "no answer at 101"
    assert phase(end) == ("outside", True)
    assert answer.notices[0] == Notice("no answer at 101", "warning", "refusals")
    assert answer.record is not None
    assert answer.publish == ()
    end.hears(measurement(k=5, applied_k=3, x=(0.0,), x_after=(101.0,)), 2.0)
    assert phase(end) == ("running", False)


@pytest.mark.parametrize("record", [None, AT_WORK])
def test_only_who_has_met_no_plant_gives_up_over_another_model(
    record: ControllerRecord | None,
) -> None:
    end = Told(record=record)
    end.does(end.core.start(0.0))
    answer = end.hears(hello(fingerprint="e" * 64), 1.0)
    (said,) = answer.publish
    assert isinstance(said, ControllerHello)
    assert (said.verdict, said.answers) == ("other-model", P)
    levels = [(n.level, n.subject) for n in answer.notices]
    if record is not None:
        assert (end.core.code, (end.core.state.session.state == "refused")) == (None, False)
        assert levels == [("warning", "refusals")]
        assert phase(end) == ("greeting", True)
        return
    assert (end.core.code, (end.core.state.session.state == "refused")) == (USAGE, True)
    assert levels == [("warning", "refusals"), ("error", "")]
    assert phase(end) == ("refused", True)
    for text in (status_of(end.core).detail, answer.notices[1].text):
        assert "e" * 8 in text
        assert "f" * 8 in text
        assert "e" * 9 not in text
    stopped = told(gathered(end.core.stop(2.0)))
    assert stopped["phase"] == "refused", "whoever looks later sees why"


# --- alarms ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("halts", [False, True])
def test_an_alarm_says_what_was_read_and_what_was_expected(halts: bool) -> None:
    end = Told(replace(RULES, halts=halts)).at_work()
    end.hears(measurement(x=(3.0,), x_after=(3.0,)), 1.0)
    alarm = Alarm(S, 2, 3, (3.0,), "unexplained", 0, (1.5,), 1.5)
    (counted,) = [a for a in end.all if a.events]
    assert [type(event) for event in counted.events] == [CountedTransition, Alarm]
    assert counted.events[1] == alarm
    levels = [(n.level, n.subject) for asked in end.all for n in asked.notices]
    assert levels == [("warning", "refusals")] * halts + [("error", "alarms")]
    assert "step 3" in counted.notices[-1].text
    status = status_of(end.core)
    assert (status.alarms, status.alarm_k) == (1, 3)
    assert (status.alarm_reading, status.alarm_expected) == ((3.0,), (1.5,))
    assert (status.alarm_gauge, status.unexplained) == (1.5, 1)
    assert (status.phase, bool(status.detail)) == (
        ("alarmed", True) if halts else ("running", False)
    )
    offered = [m for a in end.all for m in a.publish if isinstance(m, Offer)]
    assert len(offered) == (not halts)
    assert end.core.state.record.alarms.halted == halts
    again = end.hears(measurement(k=5, applied_k=3, x=(3.0,), x_after=(3.0,)), 2.0)
    assert (again == NOTHING) == halts
    assert status_of(end.core).alarms == 1


# --- the keyed coin -------------------------------------------------------------------------------

COIN = replace(RULES, schedule=SCHEDULE, keyed=True)
DIGITS = digits(bytes(range(32)), 2)
HELD = Held(Part(0, 0, bytes(DIGITS)))
CONFIRMED = changed(AT_WORK, transitions=3, block=0, tag="a" * 32, confirmed=0)
"""Block 0 is confirmed, and its digits are held."""
NAMED = OFFER.model_copy(update={"stream_block": 0, "stream_at": 0, "block": 0, "tag": "a" * 32})


def keyed(
    record: ControllerRecord = CONFIRMED,
    held: Held = HELD,
    rules: Rules = COIN,
    **step: Any,
) -> Told:
    end = Told(rules, record, held=held, **step)
    end.does(end.core.start(0.0))
    end.hears(hello(transitions=3, applied_k=1), 0.0)
    end.all.clear()
    return end


def named(actions: Asked) -> tuple[int | None, int | None]:
    """The position of the offer's digits."""
    (offer,) = actions.publish
    assert isinstance(offer, Offer)
    return offer.stream_block, offer.stream_at


def keyed_measurement(**fields: object) -> Measurement:
    return measurement(**{"keyed": False, **fields})


def test_each_offer_names_the_next_digits_whether_or_not_it_is_applied() -> None:
    end = keyed(changed(CONFIRMED, offer=None, k=2))
    assert status_of(end.core).digits_left == len(DIGITS)
    unapplied = keyed_measurement(k=3, applied_k=1, x=(0.0,), x_after=())
    assert named(end.hears(unapplied, 1.0)) == (0, 0)
    assert named(end.hears(unapplied, 1.5)) == (0, 0), "the same offer again"
    following = keyed_measurement(k=4, applied_k=1, x=(0.0,), x_after=())
    assert named(end.hears(following, 2.0)) == (0, 1)
    assert status_of(end.core).digits_left == len(DIGITS) - 1


@pytest.mark.parametrize("right", [True, False])
@pytest.mark.parametrize("known", [True, False])
def test_a_transition_is_watched_where_digits_served(known: bool, right: bool) -> None:
    end = keyed(changed(CONFIRMED, offer=NAMED if known else OFFER))
    chosen = DIGITS[0] if right else 1 - DIGITS[0]
    x = CANDIDATES[chosen]
    end.hears(keyed_measurement(x=x, x_after=x, keyed=known), 1.0)
    status = status_of(end.core)
    assert (status.watched, status.unwatched) == (known, not known)
    alarms = [e for a in end.all for e in a.events if isinstance(e, Alarm)]
    assert len(alarms) == (known and not right)
    assert [e.expected for a in end.all for e in a.events if isinstance(e, CountedTransition)] == [
        DIGITS[0] if known else -1
    ]
    for alarm in alarms:
        expected = CANDIDATES[DIGITS[0]]
        assert alarm == Alarm(S, 3, 3, x, "another candidate", DIGITS[0], expected, 3.0)
    assert status.alarms == len(alarms)


# --- it fails closed ------------------------------------------------------------------------------

SEALED = replace(RULES, schedule=SCHEDULE, scheme=Sealed(2))


@pytest.mark.parametrize("rules", [COIN, SEALED])
@pytest.mark.parametrize("again", [True, False])
def test_once_the_claim_is_refuted_no_digit_serves_any_more(rules: Rules, again: bool) -> None:
    record = changed(CONFIRMED, state=rules.scheme.initial, offer=None, k=2)
    end = keyed(record, rules=rules)
    stopped = end.hears(StopKeys(reason="Eve missed nothing"), 1.0)
    assert [(n.level, n.subject) for n in stopped.notices] == [("error", "")]
    assert stopped.saved.durable
    assert end.hears(StopKeys(reason="once more"), 1.0) == NOTHING
    if again:  # another process, as the journal has it
        loaded = end.journal.load()
        assert loaded.record is not None
        end = keyed(loaded.record, HELD if loaded.held == NOTHING_HELD else loaded.held, rules)
    assert status_of(end.core).keys_refused == "Eve missed nothing"
    answer = end.hears(keyed_measurement(k=3, applied_k=1, x=(0.0,), x_after=()), 2.0)
    assert named(answer) == (-1, 0)


# --- what is malformed ----------------------------------------------------------------------------


# --- greetings ------------------------------------------------------------------------------------


def test_it_greets_a_stranger_again_when_the_time_is_over_and_not_before() -> None:
    end = Told(record=None)
    end.does(end.core.start(0.0))
    assert len(end.hears(measurement(), 10.0).publish) == 1
    for now in (10.0, 10.0 + 0.99 * GREETING_S):
        assert end.hears(measurement(), now) == NOTHING
    again = end.hears(measurement(), 10.0 + GREETING_S)
    assert again == Asked(publish=(end.all[1].publish[0],))
    assert end.hears(measurement(), 10.0 + 1.99 * GREETING_S) == NOTHING


# --- commands -------------------------------------------------------------------------------------


# --- key blocks -----------------------------------------------------------------------------------

TAG = "a" * 32
MADE = ExtractedBlock(S, 0, TAG, (b"k" * 32, b"l" * 32))


def keys_at_work() -> Told:
    """Block 0 is whole and extracted, and not confirmed."""
    rows = tuple(Contribution(j, 1, b"n" * 32, b"m" * 32) for j in (1, 2, 3))
    record = changed(AT_WORK, transitions=4)
    end = Told(KEYS, record, contributions=rows)
    end.does(end.core.start(0.0))
    end.hears(hello(transitions=4, applied_k=1), 0.0)
    assert end.does(end.core.extracted(MADE)) == NOTHING
    end.all.clear()
    return end


def test_a_measurement_with_the_same_tag_confirms_a_block_and_saves_its_digits() -> None:
    end = keys_at_work()
    end.hears(measurement(block=0, tag=TAG, nonce=NONCE), 1.0)
    _, counted = end.all
    assert counted.events[0] == BlockEnded(S, 0, "confirmed", 2)
    assert [n.level for n in counted.notices] == ["info"], "what the first keys rest on"
    assert end.core.state.record.link.nonce == NONCE
    status = status_of(end.core)
    assert (status.keys_made, status.keys_of_block, status.key_block_steps) == (2, 2, 2)
    assert status.digits_left == sum(len(digits(key, 2)) for key in MADE.keys)
    saved = end.hears(measurement(k=5, applied_k=4), 2.0)
    assert saved.record is not None
    assert saved.record.keys.confirmed == 0
    assert saved.saved.rows.obsolete_rows == (range(1, 3),), "rows of a block that is confirmed go"
    assert saved.saved.rows.keys == (BlockKeys(0, 0, b"".join(MADE.keys)),)
    again = end.hears(measurement(k=6, applied_k=5), 3.0)
    assert (again.saved.rows.obsolete_rows, again.saved.rows.keys) == ((), ()), "once"


def test_more_links_than_were_stated_stop_keys_until_they_are_gone() -> None:
    end = keys_at_work()
    k = end.core.state.record.link.k
    for count, level in ((3, "error"), (1, "info")):
        actions = gathered(end.core.appear(count))
        assert actions.events == (Appearances(S, k, count),)
        (notice,) = actions.notices
        assert (notice.level, notice.subject) == (level, "appearances")
        assert f"{count} time" in notice.text
        assert gathered(end.core.appear(count)) == Asked(events=actions.events), (
            "as often as before"
        )
        status = status_of(end.core)
        assert (status.appearances, bool(status.keys_stopped)) == (count, count > 1)
        said = end.hears(measurement(k=k + count, applied_k=1, x_after=()), 10.0 / count)
        (offer,) = said.publish
        assert isinstance(offer, Offer)
        assert offer.copy_number == (count > 1), "no first copy may appear more often"
        k = end.core.state.record.link.k


def test_old_measurements_end_nothing_before_there_are_so_many_in_a_new_session() -> None:
    """A session that ends, or begins, has had none of them."""
    old = measurement(k=2, applied_k=1)
    end = Told().at_work()
    for i in range(STALE - 1):
        assert end.hears(old, 1.0 + i * STALE_S) == NOTHING
    end.hears(hello(session=NEW), 10.0)
    assert end.core.state.record.session.id == NEW
    end.hears(measurement(session=NEW, k=7, applied_k=-1, x_after=()), 11.0)
    old = old.model_copy(update={"session": NEW})
    for i in range(STALE - 1):
        assert end.hears(old, 12.0 + i * STALE_S) == NOTHING
    assert end.notices[-1:] != [("warning", "refusals")]
    end.hears(old, 20.0)
    assert end.core.state.record.session.id is None
