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
from protocol.link.guarded import LACKING_S, UNOPENED, Guarded, GuardStatus
from protocol.link.peer import Actions, Notice
from protocol.messages import (
    ControllerHello,
    ControllerStatus,
    Measurement,
    Message,
    Offer,
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
    assert list(told.values()) == [3, 4, 5, 6, 7]
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
    assert isinstance(task, GuardTask)
    assert (task.session, task.instance, task.heard_after) == (S, C, 0)
    assert (task.wants, task.session_words, task.step_words) == (False, 0, 0), "it sends none"
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
