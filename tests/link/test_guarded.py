"""An end whose messages are guarded, alone: what leaves, what is let through, what is told."""

import re
from collections.abc import Callable
from math import inf
from random import Random
from typing import NamedTuple

import pytest
from pydantic_core import from_json

from protocol.defence.base import Defence
from protocol.defence.coding import Coding
from protocol.defence.mac import Mac
from protocol.link.events import Forged
from protocol.link.guarded import (
    AGAIN_S,
    AHEAD,
    LACKING_S,
    MARGIN,
    UNOPENED,
    Guarded,
    GuardStatus,
)
from protocol.link.peer import Actions, Notice
from protocol.messages import (
    ControllerHello,
    ControllerStatus,
    Measurement,
    Message,
    Offer,
    PlantHello,
    PlantStatus,
)
from protocol.secret.blocks import BlockResult
from protocol.secret.tasks import Batch, Broken, CoinKeys, GuardKeys, GuardTask
from tests.support.hearing import Hearing

S, T = "1" * 16, "2" * 16
P, C = "a" * 16, "c" * 16
GUARDS: list[Callable[[int, int], Defence]] = [Mac, Coding]
FIRST = 10
"""The step with which the first batch begins; a batch has 32 words."""


def batch(number: int, first: int = -1, of: int = 0) -> Batch:
    return Batch(number, Random(2 * number + of).randbytes(4 * 32), first)


@pytest.mark.parametrize("status", [PlantStatus, ControllerStatus])
def test_what_is_told_of_it_is_in_the_statuses_of_both_ends(status: type[Message]) -> None:
    told = GuardStatus(3, 4, 5, 6, 7).fields()
    assert told == {"guarded": 3, "unguarded": 4, "guard_ahead": 5, "forged": 6, "forged_k": 7}
    assert set(told) <= set(status.model_fields)


class Ends(NamedTuple):
    """Both ends of a session, with batches 0 and 1 of each direction that is guarded."""

    plant: Guarded
    controller: Guarded
    at_plant: Hearing
    at_controller: Hearing
    ended: list[str]
    """Why sessions were ended."""


def begun(defence: Defence, *, heard: int = 2, promise: tuple[int, int] = (-1, -1)) -> Ends:
    """``heard`` so many batches of the plant's are held by the controller."""
    at_plant, at_controller, ended = Hearing(inf), Hearing(inf), list[str]()

    def anew(why: str) -> Actions:
        ended.append(why)
        return Actions(notices=(Notice(why, "error"),))

    mine = batch(0, FIRST), batch(1, next_first(defence))
    offers = (batch(0, FIRST, of=1),) if defence.tags else ()
    theirs = GuardKeys(S, offers, tuple(batch(n) for n in range(heard)), promise)
    own = GuardKeys(S, mine, (batch(0, of=1),) if defence.tags else ())
    return Ends(
        Guarded(at_plant, "plant", defence, P, anew, S, own),
        Guarded(at_controller, "controller", defence, C, anew, S, theirs),
        at_plant,
        at_controller,
        ended,
    )


def next_first(defence: Defence) -> int:
    """The step after those that the first batch covers."""
    return FIRST + (32 - defence.session_words) // defence.step_words - 1


def measurement(k: int, applied_k: int | None = None) -> Measurement:
    """Of step k; the plant's state is another one in each."""
    applied = k - 1 if applied_k is None else applied_k
    return Measurement(session=S, k=k, x=state(k), applied_k=applied, x_after=state(applied + 1))


def state(k: int) -> tuple[float, float]:
    return (0.1 + k, -2.3 * k)


def offer(k: int) -> Offer:
    return Offer(session=S, k=k, candidates=((0.1,), (1.0,)), cipher=0)


def leaves(end: Guarded, inner: Hearing, message: Message) -> bytes:
    """The bytes of a message that the end says."""
    inner.says_now = (message,)
    (out,) = end.wake(0.0).publish
    inner.says_now = ()
    return out.wire()


def tampered(wire: bytes) -> bytes:
    """With another number in it."""
    return re.sub(rb"\.1\d*", b".5", wire, count=1)


# --- what leaves ----------------------------------------------------------------------------------


@pytest.mark.parametrize("made", GUARDS)
def test_whatever_lets_a_message_leave_it_is_guarded(made: Callable[[int, int], Defence]) -> None:
    ends = begun(made(2, 4))
    end, said = ends.plant, measurement(FIRST)
    ends.at_plant.says_now = (said,)
    hello = ControllerHello(
        instance=C, incarnation=1, fingerprint="f" * 64, verdict="greeting", session=S, answers=P
    )
    for actions in (
        end.start(0.0),
        end.wake(0.0),
        end.receive(ControllerHello, hello.wire(), 0.0),
        end.finish_step(),
        end.key_task_done(BlockResult(S, 0, "confirmed", 5), 0.0),
        end.appear(1),
        end.stop(0.0),
    ):
        (out,) = actions.publish
        assert b'"guard":"0/0"' in out.wire()
        assert isinstance(out, Measurement)
        assert out == said, "who saves and traces it sees it plain"


@pytest.mark.parametrize("missed", [0, 1, 5])
def test_a_coded_measurement_shows_no_state_in_either_place(missed: int) -> None:
    """``x_after`` is under the key of its own step: of the batch before, where it must be."""
    defence = Coding(2, 4)
    ends = begun(defence)
    at = next_first(defence) - 3
    for k in (FIRST, at + 1, *range(at + 1 + missed, at + 10)):
        applied = at if at < k <= at + 1 + missed else k - 1
        for said in (measurement(k, applied), measurement(k, applied)):
            wire = leaves(ends.plant, ends.at_plant, said)
            shown = from_json(wire)
            assert tuple(shown["x"]) != said.x
            assert tuple(shown["x_after"]) != said.x_after
            ends.controller.receive(Measurement, wire, 0.0)
            _, kind, heard = ends.at_controller.heard.pop()
            assert kind is Measurement
            assert Measurement.model_validate_json(heard) == said


@pytest.mark.parametrize("made", GUARDS)
def test_a_message_that_is_said_again_leaves_the_same_way(
    made: Callable[[int, int], Defence],
) -> None:
    defence = made(2, 4)
    ends = begun(defence)
    for k in (FIRST, next_first(defence) - 1, next_first(defence)):
        wires = {leaves(ends.plant, ends.at_plant, measurement(k)) for _ in range(3)}
        assert len(wires) == 1


# --- what is let through --------------------------------------------------------------------------


def test_an_offer_that_was_changed_is_refused_and_told_once_and_the_right_one_is_heard() -> None:
    ends = begun(Mac(2, 4))
    wire = leaves(ends.controller, ends.at_controller, offer(12))
    for again in range(2):
        refused = ends.plant.receive(Offer, tampered(wire), 0.0)
        assert ends.at_plant.heard == []
        assert [n.subject for n in refused.notices] == ["alarms"]
        assert len(refused.events) == (0 if again else 1)
        for event in refused.events:
            assert isinstance(event, Forged)
            assert (event.session, event.k, event.message) == (S, 12, "offer")
            assert event.why
    ends.plant.receive(Offer, wire, 1.0)
    ((at, kind, heard),) = ends.at_plant.heard
    assert (at, kind) == (1.0, Offer)
    assert Offer.from_wire(heard) == offer(12)
    status = ends.plant.status()
    assert (status.guarded, status.unguarded, status.forged, status.forged_k) == (1, 0, 2, 12)


def test_a_measurement_that_was_changed_is_refused_at_the_controller() -> None:
    ends = begun(Mac(2, 4))
    wire = leaves(ends.plant, ends.at_plant, measurement(12))
    refused = ends.controller.receive(Measurement, tampered(wire), 0.0)
    assert [type(event) for event in refused.events] == [Forged]
    assert ends.at_controller.heard == []
    ends.controller.receive(Measurement, wire, 0.0)
    assert len(ends.at_controller.heard) == 1


def test_a_forgery_is_what_the_end_does_over_one() -> None:
    end = Hearing(inf)
    halts = Actions(notices=(Notice("halted", "warning", "refusals"),))
    keys = GuardKeys(S, (), (batch(0),))
    guarded = Guarded(
        end, "controller", Mac(2, 4), C, lambda why: Actions(), S, keys, lambda: halts
    )
    ends = begun(Mac(2, 4))
    wire = leaves(ends.plant, ends.at_plant, measurement(12))
    refused = guarded.receive(Measurement, tampered(wire), 0.0)
    assert {n.subject for n in refused.notices} == {"alarms", "refusals"}


def test_before_its_keys_a_message_waits_and_they_are_asked_for_at_once() -> None:
    ends = begun(Coding(2, 4), heard=1)
    wire = leaves(ends.plant, ends.at_plant, measurement(next_first(Coding(2, 4))))
    (task,) = ends.controller.receive(Measurement, wire, 0.0).keys
    assert task == GuardTask(S, C, 0, MARGIN - 1, heard_after=0), "it sends none guarded"
    assert ends.at_controller.heard == []
    assert ends.controller.receive(Measurement, wire, 0.0).keys == (), "they are asked for already"
    ends.controller.key_task_done(GuardKeys(S, (), (batch(1),)), 0.0)
    ends.controller.receive(Measurement, wire, 0.0)
    assert len(ends.at_controller.heard) == 1


def test_a_message_of_another_session_is_the_ends_to_judge_as_it_is() -> None:
    ends = begun(Mac(2, 4))
    strange = measurement(FIRST).model_copy(update={"session": T}).wire()
    for now, payload in ((2.0, strange), (3.0, b"no message")):
        ends.controller.receive(Measurement, payload, now)
        assert ends.at_controller.heard.pop() == (now, Measurement, payload)
    status = ends.controller.status()
    assert (status.guarded, status.unguarded, status.forged) == (0, 0, 0)


def test_a_message_whose_keys_are_nowhere_counts_as_bare_until_one_was_tagged() -> None:
    for promise, heard in (((-1, -1), 1), ((FIRST - 1, 0), 0)):
        ends = begun(Mac(2, 4), heard=0, promise=promise)
        wire = leaves(ends.plant, ends.at_plant, measurement(FIRST))
        ends.controller.receive(Measurement, wire, 0.0)
        assert ends.at_controller.heard == [], "it looks for its keys first"
        ends.controller.key_task_done(GuardKeys(S), 0.0)
        ends.controller.receive(Measurement, wire, 0.0)
        found = [Measurement.model_validate_json(said) for _, _, said in ends.at_controller.heard]
        assert found == [measurement(FIRST)] * heard
        assert ends.controller.status().unguarded == heard


def test_who_has_no_key_left_says_farewell_and_is_heard() -> None:
    """Tagged under a word that was kept for it, so that whoever strips tags is still refused."""
    defence = Mac(2, 4)
    ends = begun(defence)
    last = measurement(FIRST + 2 * (next_first(defence) - FIRST) - 1)
    after = measurement(last.k + 1)
    for said, guarded in ((last, 1), (after, 0), (after, 0)):
        wire = leaves(ends.plant, ends.at_plant, said)
        before = ends.controller.status()
        ends.controller.receive(Measurement, wire, 0.0)
        assert Measurement.model_validate_json(ends.at_controller.heard.pop()[2]) == said
        assert ends.controller.status().guarded == before.guarded + guarded
    assert ends.controller.receive(Measurement, after.wire(), 0.0).events, "bare it is a forgery"


@pytest.mark.parametrize("opened", [False, True])
def test_messages_that_do_not_open_end_the_session_unless_one_opened_before(opened: bool) -> None:
    """Keys may have gone with a process; who can only forge ends nothing."""
    defence = Mac(2, 4)
    ends = begun(defence, heard=int(opened), promise=(FIRST, 0))
    if opened:
        wire = leaves(ends.plant, ends.at_plant, measurement(FIRST))
        ends.controller.receive(Measurement, wire, 0.0)
        assert len(ends.at_controller.heard) == 1
    wire = leaves(ends.plant, ends.at_plant, measurement(next_first(defence)))
    assert ends.controller.receive(Measurement, wire, 0.0).keys, "it looks for its keys"
    ends.controller.key_task_done(GuardKeys(S), 0.0)
    for _ in range(UNOPENED - 1):
        ends.controller.receive(Measurement, wire, 0.0)
    assert ends.ended == []
    last = ends.controller.receive(Measurement, wire, 0.0)
    assert len(ends.ended) == (0 if opened else 1)
    assert ("alarms" in {n.subject for n in last.notices}) and len(
        ends.at_controller.heard
    ) == opened
    ends.controller.receive(Measurement, wire, 0.0)
    assert len(ends.ended) == (0 if opened else 1), "that is over"


@pytest.mark.parametrize("made", GUARDS)
def test_a_broken_key_store_ends_the_session_once_messages_do_not_open(
    made: Callable[[int, int], Defence],
) -> None:
    """No key comes any more, and the loop is not to stand until the partner's are used up."""
    defence = made(2, 4)
    ends = begun(defence, heard=1)
    opens = leaves(ends.plant, ends.at_plant, measurement(FIRST))
    ends.controller.receive(Measurement, opens, 0.0)
    ends.controller.key_task_done(GuardKeys(S), 0.0)
    wire = leaves(ends.plant, ends.at_plant, measurement(next_first(defence)))
    assert ends.controller.receive(Measurement, wire, 0.0).keys, "it looks for its keys"
    ends.controller.key_task_done(Broken("disk full"), 0.0)
    for _ in range(UNOPENED):
        assert ends.ended == []
        assert ends.controller.receive(Measurement, wire, 0.0).keys == (), "nobody would answer"
    assert len(ends.ended) == 1


# --- keys -----------------------------------------------------------------------------------------


def tasks(end: Guarded, inner: Hearing, message: Message, now: float) -> tuple[GuardTask, ...]:
    """What the end asks its keeper of keys as it says a message."""
    inner.says_now = (message,)
    keys = end.wake(now).keys
    inner.says_now = ()
    assert all(isinstance(task, GuardTask) for task in keys)
    return keys  # type: ignore[return-value]


def test_more_keys_are_asked_for_before_the_last_step_is_covered_and_not_twice() -> None:
    defence = Mac(2, 4)
    ends = begun(defence)
    (task,) = tasks(ends.plant, ends.at_plant, measurement(FIRST), 0.0)
    words = (task.session_words, task.step_words)
    assert words == (defence.session_words, defence.step_words)
    assert (task.wants, task.k, task.sent_after, task.heard_after) == (True, FIRST, 1, 0)
    assert task.begins == FIRST + 2 * (next_first(defence) - FIRST), "after those that it holds"
    assert tasks(ends.plant, ends.at_plant, measurement(FIRST), 0.0) == ()
    ends.plant.key_task_done(GuardKeys(S), 1.0)
    later = [
        now
        for now in (1.0, 1.0 + 0.9 * LACKING_S, 1.0 + LACKING_S)
        if tasks(ends.plant, ends.at_plant, measurement(FIRST), now)
    ]
    assert later == [1.0 + LACKING_S], "where there were none, once in a while"
    ends.plant.key_task_done(GuardKeys(S, (batch(2, task.begins),)), 3.0)
    assert ends.plant.status().ahead == 3 * (next_first(defence) - FIRST) - 1


def test_of_every_task_but_its_own_the_end_is_told() -> None:
    ends = begun(Mac(2, 4))
    confirmed, coins = BlockResult(S, 0, "confirmed", 5), CoinKeys(S)
    for done in (confirmed, GuardKeys(S), coins):
        ends.plant.key_task_done(done, 3.0)
    assert ends.at_plant.done == [(confirmed, 3.0), (coins, 3.0)]


def test_another_session_has_keys_of_its_own() -> None:
    ends = begun(Mac(2, 4))
    new = measurement(FIRST + 1).model_copy(update={"session": T})
    assert leaves(ends.plant, ends.at_plant, new) == new.wire(), "bare until there are some"
    ends.plant.key_task_done(GuardKeys(S, (batch(2, FIRST),)), 0.0)
    assert leaves(ends.plant, ends.at_plant, new) == new.wire(), "keys of the session before"
    ends.plant.key_task_done(GuardKeys(T, (batch(0, FIRST + 2),)), 0.0)
    later = measurement(FIRST + 2).model_copy(update={"session": T})
    assert b'"guard":"0/0"' in leaves(ends.plant, ends.at_plant, later)


def test_a_step_that_left_bare_stays_bare() -> None:
    """Its copies are told apart by no tag, whenever keys come."""
    ends = begun(Mac(2, 4))
    early = measurement(FIRST - 1)
    assert leaves(ends.plant, ends.at_plant, early) == early.wire()
    ends.plant.key_task_done(GuardKeys(S, (batch(2, FIRST - 1),)), 0.0)
    assert leaves(ends.plant, ends.at_plant, early) == early.wire()
    assert b'"guard"' in leaves(ends.plant, ends.at_plant, measurement(FIRST))


# --- what is counted and asked, to the step -------------------------------------------------------


def hears(ends: Ends, said: Message, now: float = 0.0) -> Actions:
    """A message of the plant's reaches the controller as it leaves."""
    wire = leaves(ends.plant, ends.at_plant, said)
    return ends.controller.receive(Measurement, wire, now)


@pytest.mark.parametrize("made", GUARDS)
def test_the_first_message_of_a_batch_counts_as_guarded(
    made: Callable[[int, int], Defence],
) -> None:
    ends = begun(made(2, 4))
    told = []
    for k in (FIRST - 1, FIRST, FIRST + 1):
        hears(ends, measurement(k))
        told.append(ends.controller.status()[:2])
    assert told == [(0, 1), (1, 1), (2, 1)]


def test_how_far_the_keys_reach_is_counted_from_the_newest_step_said() -> None:
    defence = Mac(2, 4)
    ends = begun(defence)
    assert ends.plant.status().ahead == 0
    until = FIRST + 2 * (next_first(defence) - FIRST) - 1
    for k, newest in ((FIRST, FIRST), (FIRST + 5, FIRST + 5), (FIRST, FIRST + 5), (until, until)):
        leaves(ends.plant, ends.at_plant, measurement(k))
        assert ends.plant.status().ahead == until - newest
    leaves(ends.plant, ends.at_plant, measurement(until + 4))
    assert ends.plant.status().ahead == 0
    assert begun(Coding(2, 4)).controller.status() == GuardStatus(), "its offers are not guarded"


@pytest.mark.parametrize("made", GUARDS)
def test_keys_are_asked_for_that_many_steps_before_the_last_covered_one(
    made: Callable[[int, int], Defence],
) -> None:
    defence = made(2, 4)
    for steps, asks in ((AHEAD - 1, True), (AHEAD, False)):
        size = defence.session_words + defence.step_words * (steps + 2)
        key = Random(1).randbytes(4 * size)
        end = Hearing(inf)
        guarded = Guarded(
            end, "plant", defence, P, lambda why: Actions(), S, GuardKeys(S, (Batch(0, key, 0),))
        )
        said = Measurement(session=S, k=0, x=state(0), applied_k=-1, x_after=())
        asked = tasks(guarded, end, said, 0.0)
        assert [(t.wants, t.begins, t.k, t.sent_from) for t in asked] == [
            (True, max(MARGIN, steps + 1), 0, 0)
        ] * asks


def test_a_new_batch_begins_some_steps_from_here() -> None:
    end = Hearing(inf)
    guarded = Guarded(end, "plant", Mac(2, 4), P, lambda why: Actions(), S)
    (task,) = tasks(guarded, end, measurement(7), 0.0)
    assert task == GuardTask(S, P, 7, 7 + MARGIN, 1, 1, -1, -1, 0, 0, wants=True)


@pytest.mark.parametrize(("pending", "wait"), [(True, AGAIN_S), (False, LACKING_S)])
def test_keys_that_are_not_there_yet_are_asked_for_again(pending: bool, wait: float) -> None:
    ends = begun(Mac(2, 4))
    said = measurement(FIRST)
    assert tasks(ends.plant, ends.at_plant, said, 0.0)
    ends.plant.key_task_done(GuardKeys(S, pending=pending), 1.0)
    assert not tasks(ends.plant, ends.at_plant, said, 1.0 + 0.99 * wait)
    assert tasks(ends.plant, ends.at_plant, said, 1.0 + wait)
    ends.plant.key_task_done(GuardKeys(S, pending=pending), 2.0)
    ends.plant.key_task_done(BlockResult(S, 0, "confirmed", 5), 2.0)
    assert tasks(ends.plant, ends.at_plant, said, 2.0), "a block was confirmed: there may be some"


def test_what_the_tags_have_shown_is_written_down_once_a_batch() -> None:
    defence = Mac(2, 4)
    ends = begun(defence)
    promised = []
    for k in (FIRST, FIRST + 1, next_first(defence), next_first(defence) + 1, FIRST + 2):
        for task in hears(ends, measurement(k)).keys:
            assert isinstance(task, GuardTask)
            promised.append((k, task.promise, task.heard_from, task.heard_after))
            ends.controller.key_task_done(GuardKeys(S), float(k))
    assert promised == [
        (FIRST, (FIRST, 0), 0, 1),
        (next_first(defence), (FIRST, 1), 0, 1),
    ]


def test_a_promise_that_was_kept_is_taken_up_and_a_newer_one_stays() -> None:
    ends = begun(Mac(2, 4), promise=(FIRST - 5, 0))
    bare = measurement(FIRST - 4).wire()
    refused = ends.controller.receive(Measurement, bare, 0.0)
    assert [type(event) for event in refused.events] == [Forged]
    ends.controller.receive(Measurement, measurement(FIRST - 5).wire(), 0.0)
    assert len(ends.at_controller.heard) == 1, "up to that step one may be bare"


def test_batches_that_have_served_are_let_go_and_named_as_such() -> None:
    defence = Mac(2, 4)
    ends = begun(defence)
    first = leaves(ends.plant, ends.at_plant, measurement(FIRST))
    hears(ends, measurement(next_first(defence)))
    ends.controller.key_task_done(GuardKeys(S), 0.0)
    heard = len(ends.at_controller.heard)
    assert ends.controller.receive(Measurement, first, 0.0) == Actions(), "it is late"
    assert len(ends.at_controller.heard) == heard
    (task,) = tasks(ends.controller, ends.at_controller, offer(next_first(defence)), 9.0)
    assert (task.heard_from, task.sent_from) == (1, 0)


@pytest.mark.parametrize(
    "payload",
    [
        b"no json",
        b"[]",
        b"{}",
        b'{"session":1,"k":3}',
        b'{"session":"%s"}' % S.encode(),
        b'{"session":"%s","k":"3"}' % S.encode(),
        b'{"session":"%s","k":-2}' % S.encode(),
    ],
)
def test_what_is_no_message_of_a_step_is_the_ends_to_judge(payload: bytes) -> None:
    ends = begun(Mac(2, 4), promise=(0, 0))
    actions = ends.controller.receive(Measurement, payload, 4.0)
    assert actions == Actions()
    assert ends.at_controller.heard == [(4.0, Measurement, payload)]
    assert ends.controller.status() == GuardStatus()


def test_step_0_is_a_step() -> None:
    ends = begun(Mac(2, 4), promise=(0, 0))
    end = ends.controller
    end.receive(Measurement, measurement(0).model_copy(update={"x_after": ()}).wire(), 0.0)
    assert end.status().unguarded == 1


def hello(instance: str) -> bytes:
    return b'{"instance":"%s"}' % instance.encode()


@pytest.mark.parametrize(("process", "ends_it"), [(P, False), ("b" * 16, True)])
def test_another_process_of_the_partners_may_have_lost_its_keys(
    process: str, ends_it: bool
) -> None:
    """Then the count begins anew, and messages that do not open end the session again."""
    defence = Mac(2, 4)
    ends = begun(defence, heard=1)
    ends.controller.receive(PlantHello, hello(P), 0.0)
    hears(ends, measurement(FIRST))
    ends.controller.key_task_done(GuardKeys(S), 0.0)
    wire = leaves(ends.plant, ends.at_plant, measurement(next_first(defence)))
    ends.controller.receive(Measurement, wire, 0.0)
    ends.controller.key_task_done(GuardKeys(S), 0.0)
    for _ in range(UNOPENED - 1):
        ends.controller.receive(Measurement, wire, 0.0)
    ends.controller.receive(PlantHello, hello(process), 0.0)
    ends.controller.receive(Measurement, wire, 0.0)
    assert ends.ended == []
    for _ in range(UNOPENED - 2):
        ends.controller.receive(Measurement, wire, 0.0)
    assert ends.ended == []
    ends.controller.receive(Measurement, wire, 0.0)
    assert len(ends.ended) == ends_it


@pytest.mark.parametrize("payload", [b"[]", b"no json", b"{}", b'{"instance":3}'])
def test_a_hello_of_nobody_is_passed_on(payload: bytes) -> None:
    ends = begun(Mac(2, 4))
    assert ends.controller.receive(PlantHello, payload, 2.0) == Actions()
    assert ends.at_controller.heard == [(2.0, PlantHello, payload)]


def test_a_forgery_is_an_event_of_its_step_an_error_and_what_the_end_does() -> None:
    end = Hearing(inf)
    halts = Actions(
        events=(Forged(S, 99, "offer", "the end's own"),),
        notices=(Notice("halted", "warning", "refusals"),),
    )
    guarded = Guarded(
        end,
        "controller",
        Mac(2, 4),
        C,
        lambda why: Actions(),
        S,
        GuardKeys(S, (), (batch(0),)),
        lambda: halts,
    )
    ends = begun(Mac(2, 4))
    for number, k in enumerate((12, 12, 13), 1):
        changed = leaves(ends.plant, ends.at_plant, measurement(k))
        refused = guarded.receive(Measurement, tampered(changed), 0.0)
        (alarm, halted) = refused.notices
        assert (alarm.level, alarm.subject) == ("error", "alarms")
        assert str(k) in alarm.text
        assert halted == halts.notices[0]
        *own, last = refused.events
        assert last == halts.events[0]
        assert own == ([] if number == 2 else [Forged(S, k, "measurement", "its tag is wrong")])
        assert (guarded.status().forged, guarded.status().forged_k) == (number, k)


def test_the_session_that_ends_over_lost_keys_is_told_after_the_forgery() -> None:
    defence = Mac(2, 4)
    ends = begun(defence, heard=0, promise=(FIRST - 1, 0))
    wire = leaves(ends.plant, ends.at_plant, measurement(FIRST))
    assert len(ends.controller.receive(Measurement, wire, 0.0).keys) == 1
    ends.controller.key_task_done(GuardKeys(S), 0.0)
    said = [ends.controller.receive(Measurement, wire, 0.0) for _ in range(UNOPENED)]
    assert [len(actions.events) for actions in said] == [1, *[0] * (UNOPENED - 1)]
    last = said[-1].notices
    assert [(n.level, n.subject) for n in last] == [("error", "alarms"), ("error", "")]
    assert ends.ended
    assert ends.controller.receive(Measurement, wire, 0.0) == Actions(), "the end judges it"


def test_an_end_without_a_session_waits_for_the_first_that_it_says() -> None:
    end = Hearing(inf)
    guarded = Guarded(end, "plant", Mac(2, 4), P, lambda why: Actions())
    assert guarded.code is None
    assert guarded.status() == GuardStatus()
    guarded.receive(Offer, offer(12).wire(), 1.0)
    assert end.heard.pop() == (1.0, Offer, offer(12).wire())
    guarded.receive(Offer, b"no offer", 1.5)
    assert end.heard.pop() == (1.5, Offer, b"no offer")
    assert guarded.status() == GuardStatus(), "it is in no session"
    assert len(tasks(guarded, end, measurement(FIRST), 2.0)) == 1
    guarded.receive(Offer, offer(12).wire(), 3.0)
    assert guarded.status().unguarded == 1


def test_what_asks_no_time_asks_for_no_keys() -> None:
    ends = begun(Mac(2, 4))
    ends.at_plant.says_now = (measurement(FIRST),)
    for actions in (ends.plant.finish_step(), ends.plant.appear(1), ends.plant.stop(0.0)):
        assert actions.keys == ()
    assert len(ends.plant.start(0.0).keys) == 1


def test_other_messages_of_an_end_leave_as_they_are() -> None:
    ends = begun(Mac(2, 4))
    mine, other = measurement(FIRST), offer(3)
    ends.at_plant.says_now = (other, mine)
    first, second = ends.plant.wake(0.0).publish
    assert first is other
    assert b'"guard"' in second.wire()
    ends.at_plant.says_now = (other,)
    assert ends.plant.wake(0.0) == Actions(publish=(other,))


def test_an_end_is_told_the_time() -> None:
    ends = begun(Mac(2, 4))
    end = ends.at_plant
    ends.plant.start(1.0)
    ends.plant.wake(2.0)
    ends.plant.appear(3)
    ends.plant.stop(4.0)
    assert (end.started, end.woken, end.stopped, end.appearances) == ([1.0], [2.0], [4.0], 3)
    assert ends.plant.wake_at() == end.due


def test_each_batch_that_is_lacking_is_looked_for_once() -> None:
    defence = Mac(2, 4)
    ends = begun(defence, heard=0)
    early = leaves(ends.plant, ends.at_plant, measurement(FIRST))
    late = leaves(ends.plant, ends.at_plant, measurement(next_first(defence)))
    controller = ends.controller
    assert len(controller.receive(Measurement, early, 0.0).keys) == 1
    assert controller.receive(Measurement, late, 0.0) == Actions(), "it has asked"
    controller.key_task_done(GuardKeys(S), 0.0)
    assert len(controller.receive(Measurement, late, 0.0).keys) == 1
    controller.key_task_done(GuardKeys(S), 0.0)
    for number, wire in enumerate((late, early), 1):
        assert controller.receive(Measurement, wire, 0.0).keys == ()
        assert len(ends.at_controller.heard) == number, "bare, as its keys are nowhere"
    other = begun(defence, heard=0)
    assert len(other.controller.receive(Measurement, late, 0.0).keys) == 1
    other.controller.key_task_done(GuardKeys(S), 0.0)
    assert other.controller.receive(Measurement, early, 0.0).keys == (), "an older one"


@pytest.mark.parametrize(("made", "kept"), [(Mac, 1), (Coding, 0)])
def test_a_batch_is_let_go_once_nothing_leaves_under_it_any_more(
    made: Callable[[int, int], Defence], kept: int
) -> None:
    """A coded measurement may have to say a state of the batch before once more."""
    defence = made(2, 4)
    ends, at = begun(defence), next_first(defence)
    leaves(ends.plant, ends.at_plant, measurement(at - 1))
    ends.plant.key_task_done(GuardKeys(S), 0.0)
    (task,) = tasks(ends.plant, ends.at_plant, measurement(at + 3, at - 2), 10.0)
    assert task.sent_from == kept
    ends.plant.key_task_done(GuardKeys(S), 10.0)
    (task,) = tasks(ends.plant, ends.at_plant, measurement(at + 5, at + 3), 20.0)
    assert task.sent_from == 1


@pytest.mark.parametrize("k", [FIRST - 1, FIRST])
def test_an_answer_leaves_guarded_and_asks_for_more_keys(k: int) -> None:
    ends = begun(Mac(2, 4))
    wire = leaves(ends.plant, ends.at_plant, measurement(k))
    ends.at_controller.says_now = (offer(FIRST),)
    heard = ends.controller.receive(Measurement, wire, 0.0)
    (answer,) = heard.publish
    assert b'"guard":"0/0"' in answer.wire()
    assert len(heard.keys) == 1
    lost = begun(Mac(2, 4))
    lost.at_controller.says_now = (offer(FIRST),)
    assert len(lost.controller.receive(Measurement, b"no message", 0.0).keys) == 1
    lost.controller.key_task_done(GuardKeys(S), 0.0)
    assert lost.controller.receive(ControllerHello, b"{}", 0.5).keys == ()
    assert len(lost.controller.receive(ControllerHello, b"{}", LACKING_S).keys) == 1
