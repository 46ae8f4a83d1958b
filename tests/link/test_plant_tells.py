"""All that a plant tells: each status field by field, each notice by level, each event whole."""

from collections.abc import Sequence
from dataclasses import replace
from math import inf
from typing import Any

import pytest

from plant_service.adapters.base import PlantError
from plant_service.core import PlantCore
from plant_service.status import PlantTelemetry
from plant_service.watchdog import FAREWELL_S, MEETING_S
from protocol.link.distiller import BlockEnded
from protocol.link.effects import Notice, Save
from protocol.link.events import (
    FELL_BACK,
    Interrupted,
    Missed,
    PowerFailed,
    SessionBegan,
    Timing,
)
from protocol.link.key_events import Appearances
from protocol.link.pacing import HEALTH_S, LOCKSTEP_REPEAT_S, Pacing, next_turn, phase_of
from protocol.link.records import Loaded, PlantRecord
from protocol.link.session import CountedTransition, Rules, Truth
from protocol.link.step import IDLE, Begun, Read, Step
from protocol.messages import (
    ControllerHello,
    Measurement,
    Message,
    Offer,
    PlantHello,
    PlantModel,
    PlantStatus,
)
from protocol.scenario import Scenario
from protocol.schemes.framing import encode_frame
from protocol.secret.blocks import ExtractedBlock, ExtractionFailed, Schedule
from protocol.secret.bound import Assumption
from protocol.secret.key_digits import digits
from protocol.secret.nonces import Contribution
from protocol.secret.stream import NOTHING_HELD, Held, Part, Position
from protocol.vectors import Vector
from runtime.chance import fresh_nonce
from runtime.errors import DONE, USAGE
from tests.support.asked import NOTHING, Asked, gathered, turns
from tests.support.end_in_hand import EndInHand, fields, status_of, unsaid
from tests.support.line import line_rules
from tests.support.records import changed, plant_record

RULES = line_rules(alpha=4.0, largest_input=5.0)
KEYS = replace(RULES, schedule=Schedule(Assumption(0.95, eps_sec=1e-2), 2, 4))
COIN = replace(KEYS, keyed=True)
S, T, NEW = "1" * 16, "2" * 16, "9" * 16
A, P = "a" * 16, "c" * 16
CANDIDATES = ((1.5,), (-1.5,))
RECORD = plant_record(session=S, k=3, x=(0.0,), u=(0.25,), transitions=2, controller=A)
OFFER = Offer(session=S, k=3, candidates=CANDIDATES, cipher=0)
NONCE = fresh_nonce()
TRUTH = Truth((7.0,), (8.0,))


class Machine:
    """A plant that goes where it is told, and remembers what it was told."""

    def __init__(self, *, acts: bool = False, device: bool = False) -> None:
        self.acts, self.device = acts, device
        self.truth: Truth | None = None
        self.coin = 0
        self.x_next: Vector = (1.5,)
        self.fallback: Vector = (0.5,)
        self.asked: list[tuple[Any, ...]] = []
        self.closing = ""

    def toss(self, j: int) -> int:
        self.asked.append(("toss", j))
        return self.coin

    def prepare(self, k: int) -> None:
        self.asked.append(("prepare", k))

    def fall_back(self, x: Vector, in_force: Vector) -> Vector:
        self.asked.append(("fall back", x, in_force))
        return self.fallback

    def begin(self, k: int, x: Vector, u: Vector) -> None:
        self.asked.append(("begin", k, x, u))

    def end(self, k: int) -> Vector:
        self.asked.append(("end", k))
        return self.x_next

    def safe(self, why: str) -> None:
        self.asked.append(("safe", why))

    def close(self) -> str:
        self.asked.append(("close",))
        return self.closing


class Told(EndInHand[PlantCore]):
    """A plant, and all that it ever did."""

    def __init__(
        self,
        rules: Rules = RULES,
        record: PlantRecord = RECORD,
        *,
        machine: Machine | None = None,
        step_s: float | None = 1.0,
        step: Step = IDLE,
        contributions: Sequence[Contribution] = (),
        held: Held = NOTHING_HELD,
        symbols: str = "",
        fresh: bool = False,
        fell_back: bool = False,
        **more: Any,
    ) -> None:
        self.machine = machine or Machine()
        coin: Any = self.machine
        loaded = Loaded(record, step, tuple(contributions), held, symbols, fell_back=fell_back)
        super().__init__(
            PlantCore(
                rules,
                self.machine,
                coin,
                self.machine.fall_back,
                Pacing(step_s, 4, 0.0),
                lambda: NEW,
                0.0,
                instance=P,
                loaded=loaded._replace(record=None) if fresh else loaded,
                first=record if fresh else None,
                **more,
            )
        )

    @property
    def events(self) -> list[Any]:
        """Of all that was traced so far; forgotten afterwards."""
        said = [event for actions in self.all for event in actions.events]
        self.all.clear()
        return said

    def met(self, now: float = 0.0) -> "Told":
        """A controller has taken up its session."""
        self.does(self.core.start(now))
        self.hears(hello(), now)
        self.hears(hello(verdict="accepted", answers=P), now)
        assert self.core.state.session.accepted
        self.all.clear()
        self.machine.asked.clear()
        return self


def hello(**fields: object) -> ControllerHello:
    made = ControllerHello(
        instance=A,
        incarnation=1,
        fingerprint=RULES.fingerprint,
        verdict="greeting",
        session=S,
        answers=None,
    )
    return made.model_copy(update=fields)


def offer(**fields: object) -> Offer:
    return OFFER.model_copy(update=fields)


def published(actions: Asked, kind: type[Message]) -> list[Any]:
    return [message for message in actions.publish if type(message) is kind]


@pytest.fixture
def news(sustained: Scenario) -> PlantTelemetry:
    return PlantTelemetry.of(sustained, "realtime", seeded=False, status_s=0.25)


# --- how a life begins ----------------------------------------------------------------------------


REPORT = Measurement(session=S, k=4, x=(1.5,), applied_k=3, x_after=(1.5,))


def test_a_plant_whose_machine_was_started_again_counts_its_step_and_begins_anew() -> None:
    end = Told(step=Read(OFFER, 0, REPORT), fell_back=True)
    end.does(end.core.start(0.0))
    last = end.all[-1]
    assert last.save == Save(end.core.state.record)
    assert [type(m) for m in last.publish] == [PlantHello]
    assert (end.core.state.record.session.id, end.core.state.record.link.k) == (NEW, 4)
    failed, resumed, counted, began = end.events
    assert failed == PowerFailed()
    assert isinstance(counted, CountedTransition)
    assert (resumed.session, counted.session) == (S, S)
    assert began == SessionBegan(NEW, FELL_BACK)
    acting = Machine(acts=True, device=True)
    dead = Told(machine=acting, step=Begun(OFFER, 0), back=(9.0,), fell_back=True)
    dead.does(dead.core.start(0.0))
    told = [PowerFailed, SessionBegan, Interrupted, SessionBegan]
    assert [type(e) for e in dead.events] == told
    assert dead.core.state.record.session.id == NEW


# --- when a status is due, and what it says -------------------------------------------------------


def test_statuses_come_at_turns_of_the_process_and_one_a_second_is_kept(
    news: PlantTelemetry,
) -> None:
    end = Told(news=news, step_s=None)
    end.does(end.core.start(0.0))
    now, kept, models, last = 0.0, 0, [], -inf
    for number in range(12):
        actions = end.wakes(now)
        (status,) = published(actions, PlantStatus)
        models.append(len(published(actions, PlantModel)))
        if models[-1]:
            shown = [m for m in actions.publish if not isinstance(m, PlantHello)]
            assert shown == [news.model, status], "the model stands before the status"
        assert status.seq == number + 1
        assert (actions.health is not None) == (now >= last + HEALTH_S)
        if actions.health is not None:
            assert actions.health == status
            last, kept = now, kept + 1
        following = next_turn(now, 0.25, phase_of(P))
        assert published(end.wakes((now + following) / 2), PlantStatus) == []
        now = following
    assert kept == 3
    assert models == [1, 0, 0, 0] * 3


def test_a_status_says_what_record_and_keys_and_counts_hold(news: PlantTelemetry) -> None:
    *symbols, _ = encode_frame(b"abc", 2)
    held = symbols[:40]
    record = changed(
        RECORD,
        partial="".join(map(str, held)),
        state=(1, -1),
        transitions=60,
        p=40,
        sessions=2,
        missed=7,
        agreements=30,
        symbol_errors=3,
        messages=4,
        frames_refused=5,
        blocks_begun=6,
        applied_k=2,
        x=(0.5,),
    )
    end = Told(KEYS, record, news=news).met()
    gathered(end.core.receive(Offer, b"{", 0.0))
    said = fields(status_of(end.core, 0.0))
    assert said == unsaid(PlantStatus) | {
        "phase": "running",
        "session": S,
        "sessions": 2,
        "k": 3,
        "x": (0.5,),
        "transitions": 60,
        "missed": 7,
        "late": 0,
        "malformed": 1,
        "agreements": 30,
        "symbol_errors": 3,
        "rate_hz": 0.0,
        "automaton": 1,
        "recovered_symbols": 40,
        "messages": 4,
        "latency_counts": said["latency_counts"],
        "partial": said["partial"],
        "frame_symbols": 40,
        "frame_length": end.core.state.frame.deframer.expected_length,
        "frames_refused": 5,
        "key_blocks_begun": 6,
    }
    assert sum(said["latency_counts"]) == 0


def test_a_step_is_told_in_the_status_after_it(news: PlantTelemetry) -> None:
    machine = Machine()
    machine.truth = TRUTH
    end = Told(news=news, machine=machine).met()
    end.wakes(0.0)  # which publishes its measurement
    before = fields(status_of(end.core, 0.0))
    end.hears(OFFER, 0.25)
    end.wakes(1.0)
    after = fields(status_of(end.core, 1.5))
    assert after == before | {
        "k": 4,
        "x": (1.5,),
        "transitions": 3,
        "agreements": 1,
        "automaton": end.core.state.record.link.state[0],
        "latency_counts": after["latency_counts"],
        "rate_hz": after["rate_hz"],
        "sampled_late_s": (0.0,) * 3,
        "actuated_after_s": (0.25,) * 3,
        "pictured_k": 3,
        "pictured_x": (0.0,),
        "pictured_candidates": CANDIDATES,
        "pictured_x_next": (1.5,),
        "pictured_gauges": (0.0, 3.0),
        "pictured_symbol": 0,
        "pictured_inside": 1,
        "tail_k": (3,),
        "tail_x": ((0.0,),),
        "tail_role": ("test",),
        "tail_symbol": (0,),
        "tail_automaton": (end.core.state.record.link.state[0],),
        "tail_coin": (0,),
        "true_x": (7.0,),
        "tail_true_x": ((7.0,),),
    }
    assert sum(after["latency_counts"]) == 1


def test_an_offer_after_its_step_is_late_once(news: PlantTelemetry) -> None:
    end = Told(news=news).met()
    end.wakes(0.0)
    end.wakes(1.0)  # missed
    assert end.core.state.record.applied.missed == 1
    assert status_of(end.core, 0.0).late == 0
    for _ in range(2):
        assert end.hears(OFFER, 1.1) == NOTHING
        assert status_of(end.core, 0.0).late == 1
    end.hears(offer(k=4), 1.2)
    end.wakes(2.0)
    for k in (3, 4):
        end.hears(offer(k=k), 2.1)  # its step was made, or it was told
    assert status_of(end.core, 0.0).late == 1
    end.wakes(3.0)
    end.hears(offer(k=5), 3.1)
    end.hears(offer(k=9), 3.1)  # of a step to come
    assert status_of(end.core, 0.0).late == 2


# --- phases and notices ---------------------------------------------------------------------------


@pytest.mark.parametrize("known", [True, False])
def test_another_model_is_the_end_only_of_who_has_met_none_of_its_own(
    known: bool, news: PlantTelemetry
) -> None:
    record = changed(RECORD, transitions=3 if known else 0)
    end = Told(record=record, news=news)
    end.does(end.core.start(0.0))
    answer = end.hears(hello(fingerprint="e" * 64), 0.0)
    (notice,) = answer.notices
    if known:
        assert (notice.level, notice.subject) == ("warning", "incompatible")
        assert [type(m) for m in answer.publish] == [PlantHello]
        assert "e" * 8 in notice.text
        assert "e" * 9 not in notice.text
        assert end.core.state.session.state != "refused"
        silent = end.hears(hello(fingerprint="e" * 64, verdict="accepted"), 0.0)
        assert silent.publish == ()
        assert len(silent.notices) == 1
        return
    assert answer == Asked(notices=(notice,))
    assert (notice.level, notice.subject) == ("error", "")
    status = status_of(end.core, 0.0)
    assert (status.phase, bool(status.detail)) == ("refused", True)
    for text in (status.detail, notice.text):
        assert "e" * 8 in text
        assert "f" * 8 in text
        assert "f" * 9 not in text
    assert end.core.wake_at() == -inf
    codes = [end.core.code]
    assert end.wakes(1.0) == NOTHING
    assert [*codes, end.core.code] == [None, USAGE]
    assert fields(gathered(end.core.stop(2.0)).publish[-1])["phase"] == "refused"


@pytest.mark.parametrize("malformed", [{"stream_block": 0}, {"stream_at": 3}])
def test_an_offer_that_names_digits_where_none_serve_is_malformed(
    malformed: dict[str, object],
) -> None:
    end = Told().met()
    (notice,) = end.hears(offer(**malformed), 0.0).notices
    assert notice.subject == "malformed"
    named = {"stream_block": 0, "stream_at": 3}
    end = Told(COIN, CONFIRMED).met()
    (notice,) = end.hears(offer(**{**named, **dict.fromkeys(malformed)}), 0.0).notices
    assert notice.subject == "malformed"
    assert end.hears(offer(**named, nonce=NONCE), 0.0).notices == ()


# --- steps ----------------------------------------------------------------------------------------


def test_a_plant_that_acts_saves_its_coin_before() -> None:
    machine = Machine(acts=True, device=True)
    machine.coin = 1
    end = Told(machine=machine).met()
    effects = iter(end.core.receive(Offer, OFFER.wire(), 0.25))
    assert next(effects) == Save(end.core.state.record, Begun(OFFER, 1))
    assert machine.asked == [("toss", 2)]
    assert end.core.state.step == Begun(OFFER, 1)
    assert [*effects] == []
    assert machine.asked[1:] == [("begin", 3, (0.0,), (-1.5,))]
    over, counted = turns(end.core.wake(1.0))
    assert machine.asked[2:3] == [("end", 3)]
    (report,) = published(over, Measurement)
    assert over.save is not None
    assert over.save.step == Read(OFFER, 1, report)
    (transition,) = counted.events
    assert isinstance(transition, CountedTransition)
    assert (transition.coin, transition.u) == (1, (-1.5,))
    assert end.core.state.record.link.k == 4


@pytest.mark.parametrize("device", [False, True])
def test_a_missed_step_is_told_whole(device: bool) -> None:
    machine = Machine(acts=device, device=device)
    machine.truth, machine.x_next = TRUTH, (4.0,)
    end = Told(machine=machine).met()
    assert end.core.wake_at() <= 1.0
    end.wakes(1.0)
    u = (0.25,) if device else machine.fallback
    assert end.events == [Missed(S, 3, (0.0,), u, (4.0,), TRUTH)]
    record = end.core.state.record
    assert (record.link.k, record.link.x, record.applied.u) == (4, (4.0,), machine.fallback)
    assert (record.applied.missed, record.link.transitions, record.link.applied_k) == (1, 2, -1)
    made = [("end", 3), ("fall back", (4.0,), (0.25,)), ("begin", 4, (4.0,), machine.fallback)]
    asked = [("fall back", (0.0,), (0.25,)), ("begin", 3, (0.0,), machine.fallback), ("end", 3)]
    assert machine.asked == (made if device else asked)


@pytest.mark.parametrize("flipped", [0, 1])
def test_what_becomes_of_a_frame_is_told_after_its_transition(
    flipped: int, news: PlantTelemetry
) -> None:
    *symbols, last = encode_frame(b"a", 2)
    record = changed(RECORD, state=(2, 0), partial="".join(map(str, symbols)), p=len(symbols))
    end = Told(record=record, news=news).met()
    end.hears(offer(cipher=last ^ flipped), 0.25)
    step, counted = end.all[-2:]
    assert step.save is not None
    assert step.save.durable, "by its report the controller takes the message for delivered"
    (transition,) = counted.events
    assert isinstance(transition, CountedTransition)
    (notice,) = counted.notices
    assert notice.subject == ""
    received = None if flipped else b"a"
    assert (transition.recovered, transition.refused) == (received, bool(flipped))
    assert transition.p == len(symbols) + 1
    if flipped:
        assert notice.level == "error"
    else:
        assert notice.level == "info"
        assert "3" in notice.text
        assert "1 bytes" in notice.text
    assert counted.save == Save(end.core.state.record, received=received)
    status = status_of(end.core, 0.0)
    assert (status.messages, status.frames_refused) == (1 - flipped, flipped)
    assert (status.last_message, status.message_k) == (("", -1) if flipped else ("a", 3))


# --- greetings, silence ---------------------------------------------------------------------------


def test_before_anybody_is_met_the_first_step_has_not_begun() -> None:
    end = Told(record=changed(RECORD, k=0, transitions=0))
    end.does(end.core.start(0.0))
    end.wakes(3.5)
    assert end.core.state.pacing.deadline == 4.5
    end.hears(hello(), 5.0)
    assert end.core.state.pacing.deadline == 6.0
    end.hears(hello(verdict="accepted", answers=P), 5.5)
    assert end.core.state.pacing.deadline == 6.5
    assert end.core.wake_at() <= 5.5
    (said,) = published(end.wakes(5.5), Measurement)
    assert said.k == 0
    end.hears(offer(k=0), 5.75)
    assert end.core.wake_at() == 6.5
    end.wakes(6.5)
    assert (end.core.state.record.link.k, end.core.state.record.applied.missed) == (1, 0)


# --- the watchdog ---------------------------------------------------------------------------------


@pytest.mark.parametrize("moved", [True, False])
def test_a_plant_without_offers_goes_to_its_safe_state(moved: bool) -> None:
    patience = 3.5 if moved else MEETING_S
    end = Told(record=RECORD if moved else changed(RECORD, k=0), step_s=None, watchdog_s=3.5).met(
        1.0
    )
    end.wakes(0.999 * (1.0 + patience))
    assert ("safe", "x") not in end.machine.asked
    assert end.core.wake_at() <= 1.0 + patience
    with pytest.raises(PlantError) as why:
        gathered(end.core.wake(1.0 + patience))
    assert f"{patience:g} s" in str(why.value)
    assert end.machine.asked == [("safe", str(why.value))]


# --- the keyed coin -------------------------------------------------------------------------------

DIGITS = digits(bytes(range(32)), 2)
HELD = Held(Part(0, 0, bytes(DIGITS)))
CONFIRMED = changed(RECORD, transitions=3, block=0, tag="a" * 32, confirmed=0)
"""Block 0 is confirmed, and its digits are held."""


def keyed(block: int, at: int, **fields: object) -> Offer:
    return offer(**{"stream_block": block, "stream_at": at, "nonce": NONCE, **fields})


@pytest.mark.parametrize("named", [True, False])
def test_a_measurement_says_whether_a_digit_chose_the_coin(named: bool) -> None:
    machine = Machine()
    machine.coin = 1 - DIGITS[0]
    end = Told(COIN, CONFIRMED, machine=machine, held=HELD).met()
    chosen = DIGITS[0] if named else 1 - DIGITS[0]
    machine.x_next = CANDIDATES[chosen]
    end.hears(keyed(*((0, 0) if named else (-1, 0))), 0.25)
    (counted,) = [e for a in end.all for e in a.events]
    assert isinstance(counted, CountedTransition)
    assert (counted.coin, counted.keyed) == (chosen, named)
    assert counted.digits == (Position(0, 0) if named else None)
    assert end.core.state.record.applied.keyed == named
    (report,) = published(end.wakes(1.0), Measurement)
    assert report.keyed == named
    left = len(DIGITS) - named
    assert end.core.state.keys.stream.left == left, "what has served is erased"


# --- key blocks -----------------------------------------------------------------------------------


def rows(until: int) -> list[Contribution]:
    return [Contribution(j, 1, b"n" * 32, b"m" * 32) for j in range(1, until)]


MADE = ExtractedBlock(S, 0, "a" * 32, (b"k" * 32, b"l" * 32))


def keys_at_work(**more: Any) -> Told:
    """Block 0 is whole and extracted, and not confirmed."""
    record = changed(RECORD, transitions=4, k=5)
    end = Told(KEYS, record, contributions=rows(4), **more)
    end.does(end.core.start(0.0))
    end.hears(hello(), 0.0)
    end.hears(hello(verdict="accepted", answers=P), 0.0)
    assert end.does(end.core.extracted(MADE)) == NOTHING
    end.all.clear()
    return end


@pytest.mark.parametrize("right", [True, False])
def test_an_offer_confirms_a_block_or_ends_the_session_over_it(right: bool) -> None:
    end = keys_at_work()
    tag = "a" * 32 if right else "c" * 32
    end.hears(offer(k=5, nonce=NONCE, block=0, tag=tag), 0.25)
    counted = end.all[1]
    ended = BlockEnded(S, 0, "confirmed", 2) if right else BlockEnded(S, 0, "unequal")
    assert counted.events[0] == ended
    if right:
        assert [n.level for n in counted.notices] == ["info"], "what the first keys rest on"
        assert counted.save is None
        assert end.core.state.record.session.id == S
        assert end.core.state.keys.stream.left == sum(len(digits(key, 2)) for key in MADE.keys)
        return
    assert [type(e) for e in counted.events[1:]] == [CountedTransition]
    anew = end.all[-1]
    assert [type(e) for e in anew.events] == [SessionBegan]
    notices = (*counted.notices, *anew.notices)
    assert [(n.level, n.subject) for n in notices] == [("error", "")] * 2
    assert NEW in notices[-1].text
    assert end.core.state.record.session.id == NEW
    assert anew.save == Save(end.core.state.record)
    assert [type(m) for m in anew.publish] == [PlantHello]
    assert end.core.state.keys.stream.left == 0


def test_blocks_are_counted_as_they_begin() -> None:
    end = Told(KEYS, changed(RECORD, transitions=0, blocks_begun=3)).met()
    begun = []
    for k in range(3, 11):
        end.hears(offer(k=k, nonce=NONCE), k - 2.75)
        end.wakes(k - 2.0)
        begun.append(end.core.state.record.keys.begun)
    assert begun == [3, 4, 4, 5, 5, 5, 5, 6], "blocks of 2 and 4, from the second transition on"


def test_blocks_that_cannot_be_extracted_are_an_error(news: PlantTelemetry) -> None:
    end = keys_at_work(news=news)
    (notice,) = gathered(end.core.extracted(ExtractionFailed("no memory"))).notices
    assert (notice.level, notice.subject) == ("error", "")
    assert "no memory" in notice.text
    assert status_of(end.core, 0.0).keys_refused == "no memory"


def test_more_links_than_were_stated_stop_keys_until_they_are_gone(news: PlantTelemetry) -> None:
    end = keys_at_work(news=news)
    for now, count, level in ((1.0, 3, "error"), (2.0, 1, "info")):
        actions = gathered(end.core.appear(count))
        assert actions.events == (Appearances(S, end.core.state.record.link.k, count),)
        (notice,) = actions.notices
        assert (notice.level, notice.subject) == (level, "appearances")
        assert f"{count} time" in notice.text
        assert gathered(end.core.appear(count)) == Asked(actions.events), "as often as before"
        status = status_of(end.core, 0.0)
        assert (status.appearances, bool(status.keys_stopped)) == (count, count > 1)
        (said,) = published(gathered(end.core.wake(now)), Measurement)
        assert said.copy_number == (count > 1)
        assert (said.nonce == end.core.state.record.link.nonce) == (count == 1)


# --- the end --------------------------------------------------------------------------------------


@pytest.mark.parametrize("round_trip_s", [None, 0.5])
def test_a_plant_that_is_over_reports_until_it_is_answered_or_time_is_up(
    round_trip_s: float | None,
) -> None:
    more: dict[str, Any] = {} if round_trip_s is None else {"round_trip_s": round_trip_s}
    end = Told(steps=3, **more)
    end.does(end.core.start(10.0))
    until = 10.0 + FAREWELL_S + (round_trip_s or 0.0)
    assert end.core.wake_at() == -inf
    (said,) = end.wakes(10.0).publish
    assert isinstance(said, Measurement)
    assert said.k == 3
    assert end.core.wake_at() == 10.0 + LOCKSTEP_REPEAT_S
    assert len(end.wakes(until - 0.001).publish) == 1
    assert end.core.code is None
    assert end.wakes(until) == NOTHING
    assert end.core.code == DONE


def test_a_plant_that_is_over_ends_with_the_answer_and_hears_nothing_else() -> None:
    end = Told(steps=3)
    end.does(end.core.start(10.0))
    end.wakes(10.0)
    for said in (offer(k=2), hello(verdict="unknown-session", answers=P), offer(k=4)):
        assert end.hears(said, 10.1) == NOTHING
    assert end.core.code is None
    assert end.hears(OFFER, 10.2) == NOTHING
    assert end.core.code == DONE


def test_a_plant_that_stops_is_safe_and_closed_and_says_what_failed(news: PlantTelemetry) -> None:
    machine = Machine()
    machine.closing = "the valve does not move"
    end = Told(machine=machine, news=news).met()
    end.wakes(0.5)  # which is no tick
    end.wakes(1.0)
    machine.asked.clear()
    stopped = gathered(end.core.stop(1.01))
    assert [what for what, *_ in machine.asked] == ["safe", "close"]
    assert machine.asked[0][1], "it is told why"
    assert stopped.events == (Timing(4, 1, (0.0,) * 3, (), 0),)
    assert stopped.notices == (Notice("the valve does not move", "error"),)
    status = stopped.publish[-1]
    assert isinstance(status, PlantStatus)
    assert (status.phase, status.k) == ("stopped", 4)
    assert stopped.health == status, "the last status is kept"
    assert stopped.save == Save(end.core.state.record)
