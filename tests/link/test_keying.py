"""One end's part in making keys: what it says, what it counts, and what it asks of the keeper."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from protocol.link.keying import Keying
from protocol.secret.tasks import Broken

from controller_service.core import ControllerCore
from plant_service.core import PlantCore
from protocol.link.key_events import Appearances, appeared
from protocol.link.pacing import Pacing
from protocol.link.peer import Actions
from protocol.link.records import ReceiverRecord, SenderRecord
from protocol.messages import Measurement, Offer
from protocol.secret.blocks import NO_TAG, BlockResult, ClosedBlock, Schedule, Stored
from protocol.secret.bound import Assumption
from protocol.secret.nonces import Contribution, as_bytes
from runtime.chance import fresh_nonce
from tests.support.controller_in_hand import PERIOD_S, OneMessage, Zeros
from tests.support.line_ends import line_rules
from tests.support.plant_in_hand import ScriptedLine

S, OTHER = "1" * 16, "2" * 16
SCHEDULE = Schedule(Assumption(0.1), 2, 4)
"""Block 0 is transitions 1 and 2, block 1 the four after them."""

NONCES = tuple(fresh_nonce() for _ in range(8))
TAG, OTHER_TAG = "a" * 32, "b" * 32


def offer(**fields: object) -> Offer:
    made = Offer(session=S, k=3, candidates=((0.0,), (1.0,)), cipher=1, nonce=NONCES[0])
    return made.model_copy(update=fields)


def said(block: int, tag: str) -> Measurement:
    return Measurement(session=S, k=3, x=(0.0,), applied_k=2, x_after=(0.0,), block=block, tag=tag)


def counting(until: int) -> Keying:
    """An end that has counted transitions 0 to ``until - 1``."""
    keying = Keying(SCHEDULE, fresh_nonce)
    keying.begin(S)
    for j in range(until):
        keying.count(j, 1, offer(), 0, NONCES[1])
    return keying


def stored(keying: Keying, number: int = 0) -> Stored:
    """Its block ``number`` comes back from the keeper."""
    (closed,) = keying.tasks()
    assert isinstance(closed, ClosedBlock)
    assert (closed.session, closed.number) == (S, number)
    done = Stored(S, number, TAG, keys=5)
    keying.done(done)
    return done


# --- no keys --------------------------------------------------------------------------------------


def test_without_keys_everything_is_constant() -> None:
    keying = Keying(None, fresh_nonce)
    keying.begin(S, 3, TAG)
    assert not keying.on
    assert keying.no_tag == keying.nonce() == ""
    assert keying.announcement() == (-1, "")
    sent = offer(nonce="")
    assert keying.again(sent) is sent
    assert keying.count(1, 1, offer(), 0, NONCES[1]) is None
    assert keying.heard(said(0, TAG)) == ()
    assert keying.tasks([BlockResult(S, 0, "confirmed")]) == ()
    assert keying.done(BlockResult(S, 0, "confirmed", 5)) == ()
    assert keying.obsolete_rows() == ()
    assert keying.status_fields("") == {
        "keys_made": 0,
        "keys_of_block": 0,
        "key_block_steps": 0,
        "keys_refused": "",
        "keys_stopped": "",
        "key_blocks_lost": 0,
        "key_blocks_waiting": 0,
        "appearances": 1,
    }


# --- copies ---------------------------------------------------------------------------------------


def test_another_copy_has_a_dummy_and_is_the_same_otherwise() -> None:
    draws = iter(NONCES[2:])
    keying = Keying(SCHEDULE, lambda: next(draws))
    assert keying.on
    assert keying.nonce() == NONCES[2]
    assert keying.again(offer()) == offer(copy_number=1, nonce=NONCES[3])
    assert keying.again(offer(copy_number=1)) == offer(copy_number=1, nonce=NONCES[4])


@pytest.mark.parametrize("applied_copy", [0, 1])
@pytest.mark.parametrize("heard", [0, 1])
def test_a_transition_contributes_the_copies_0_that_were_taken(
    applied_copy: int, heard: int
) -> None:
    keying = counting(1)
    contribution = keying.count(1, 7, offer(heard=heard), applied_copy, NONCES[1])
    assert contribution == Contribution(
        1,
        7,
        None if applied_copy else as_bytes(NONCES[0]),
        None if heard else as_bytes(NONCES[1]),
    )


def test_a_sessions_first_transition_is_in_no_block() -> None:
    keying = counting(0)
    assert keying.count(0, 1, offer(), 0, NONCES[1]) is None
    assert keying.count(1, 1, offer(), 0, NONCES[1]) is not None
    assert keying.tasks() == ()
    assert keying.count(2, 1, offer(), 0, NONCES[1]) is not None
    (closed,) = keying.tasks()
    assert isinstance(closed, ClosedBlock)
    assert (closed.transitions, closed.steps, closed.counted) == (2, 2, 4)
    assert keying.tasks() == ()


def test_keys_go_on_where_a_message_leaves_as_often_as_was_stated() -> None:
    for stated, times in ((1, "1 time "), (2, "2 times ")):
        keying = Keying(Schedule(Assumption(0.1, appearances=stated), 2, 4), fresh_nonce)
        stops = appeared(keying, S, 3, 5)
        goes_on = appeared(keying, S, 4, stated)
        assert [n.level for n in (*stops.notices, *goes_on.notices)] == ["error", "info"]
        assert times in goes_on.notices[0].text
        assert (stops.events, goes_on.events) == (
            (Appearances(S, 3, 5),),
            (Appearances(S, 4, stated),),
        )
    assert appeared(Keying(None, fresh_nonce), S, 3, 5) == Actions()


# --- words ----------------------------------------------------------------------------------------


def test_a_block_is_announced_once_it_is_stored() -> None:
    keying = counting(4)
    assert keying.no_tag == NO_TAG
    assert keying.announcement() == (-1, NO_TAG)
    stored(keying)
    assert keying.announcement() == (0, TAG)


def test_the_partners_word_confirms_a_block_or_differs() -> None:
    for tag, what in ((TAG, "confirmed"), (OTHER_TAG, "unequal")):
        keying = counting(3)
        stored(keying)
        judged = keying.heard(said(0, tag))
        assert [(j.number, j.what) for j in judged] == [(0, what)]
        assert keying.tasks(judged) == (judged[0],)
        assert keying.heard(said(0, tag)) == ()


def test_what_was_read_back_goes_on_where_it_was() -> None:
    contributions = [Contribution(j, 1, as_bytes(NONCES[0]), None) for j in (3, 4, 5)]
    keying = Keying(SCHEDULE, fresh_nonce)
    keying.begin(S, 0, TAG, contributions)
    assert keying.announcement() == (0, TAG)
    keying.count(6, 1, offer(), 0, NONCES[1])
    (closed,) = keying.tasks()
    assert isinstance(closed, ClosedBlock)
    assert (closed.number, closed.counted, closed.last) == (1, 5, 6)


def test_a_session_that_is_over_leaves_nothing() -> None:
    keying = counting(3)
    keying.end()
    assert keying.blocks is None
    assert keying.announcement() == (-1, NO_TAG)
    assert keying.tasks([BlockResult(S, 0, "confirmed")]) == ()
    keying.begin(OTHER)
    assert keying.tasks() == ()


# --- the keeper -----------------------------------------------------------------------------------


def test_a_verdict_goes_before_the_next_block() -> None:
    keying = counting(3)
    stored(keying)
    for j in range(3, 7):
        keying.count(j, 1, offer(), 0, NONCES[1])
    verdict, closed = keying.tasks(keying.heard(said(0, TAG)))
    assert isinstance(verdict, BlockResult)
    assert isinstance(closed, ClosedBlock)
    assert closed.number == 1


def test_keys_count_as_made_once_their_block_is_confirmed() -> None:
    keying = counting(3)
    stored(keying)
    assert keying.made == 0
    keying.done(BlockResult(S, 0, "unequal", 5))
    assert (keying.made, keying.last) == (0, (0, 0))
    keying.done(BlockResult(S, 0, "confirmed", 5))
    keying.done(BlockResult(S, 1, "confirmed", 3))
    assert keying.status_fields("why") == {
        "keys_made": 8,
        "keys_of_block": 3,
        "key_block_steps": 4,
        "keys_refused": "why",
        "keys_stopped": "block 0 differs from the partner's",
        "key_blocks_lost": 1,
        "key_blocks_waiting": 0,
        "appearances": 1,
    }


def test_rows_go_once_their_block_is_confirmed_and_announced() -> None:
    keying = counting(4)
    stored(keying)
    assert keying.obsolete_rows() == ()
    keying.heard(said(0, TAG))
    keying.announcement()
    assert keying.obsolete_rows() == ()
    keying.done(BlockResult(S, 0, "confirmed", 5))
    assert keying.obsolete_rows() == (range(1, 3),)
    assert keying.obsolete_rows() == ()


def test_a_block_that_the_partner_confirmed_before_it_was_stored_is_judged_at_once() -> None:
    keying = counting(7)
    first, second = keying.tasks()
    assert isinstance(first, ClosedBlock)
    assert isinstance(second, ClosedBlock)
    keying.done(Stored(S, 1, TAG, keys=5))
    keying.heard(said(1, TAG))
    late = Stored(S, 0, TAG, keys=5)
    assert keying.done(late) == (BlockResult(S, 0, "confirmed"),)


@pytest.mark.parametrize(
    ("done", "stopped"),
    [
        (Stored(S, 0, TAG, keys=5), ""),
        (Stored(S, 2, ""), "block 2 lost too many copies to make one"),
        (Stored(S, 3, "", older=True), "block 3 began before the key store did"),
    ],
)
def test_why_the_last_block_made_no_key(done: Stored, stopped: str) -> None:
    keying = counting(3)
    keying.done(done)
    assert keying.stopped == stopped
    assert keying.status_fields("")["keys_stopped"] == stopped
    keying.done(Stored(S, done.number + 1, TAG, keys=1))
    assert keying.stopped == ""


def state(keying: Keying) -> tuple[str, int]:
    told = keying.status_fields("")
    return told["keys_stopped"], told["key_blocks_lost"]


def test_the_newest_block_says_how_things_stand_and_the_lost_ones_are_counted() -> None:
    """On a busy machine `STOPPED` stood in red while later blocks made keys."""
    keying = counting(3)
    lost = "block {} lost too many copies to make one"
    seen = []
    for done in (
        Stored(S, 0, TAG, keys=5),
        Stored(S, 1, ""),
        BlockResult(S, 0, "confirmed", 5),  # an older block's verdict is late: the newest is lost
        Stored(S, 3, TAG, keys=5),
        Stored(S, 2, ""),  # told after a later one that made keys
        Stored(S, 4, ""),
        Stored(OTHER, 9, ""),  # of a session that is over
        Stored(S, 5, TAG, keys=5),
    ):
        keying.done(done)
        seen.append(state(keying))
    assert seen == [
        ("", 0),
        (lost.format(1), 1),
        (lost.format(1), 1),
        ("", 1),
        ("", 2),
        (lost.format(4), 3),
        (lost.format(4), 3),
        ("", 3),
    ]
    assert keying.made == 5


def test_blocks_that_differ_stop_the_keys_until_a_new_session() -> None:
    keying = counting(3)
    keying.done(BlockResult(S, 0, "unequal", 5))
    keying.done(Stored(S, 1, TAG, keys=5))  # stored before, and never to be confirmed
    assert state(keying) == ("block 0 differs from the partner's", 1)
    keying.begin(OTHER)
    assert state(keying) == ("", 1)


def test_a_broken_store_is_asked_for_nothing_more() -> None:
    keying = counting(3)
    assert keying.done(Broken("disk full")) == ()
    assert keying.tasks([BlockResult(S, 0, "confirmed")]) == ()
    assert keying.status_fields("why")["keys_refused"] == "disk full"


# --- an end that comes back -----------------------------------------------------------------------

ROWS = [Contribution(j, 1, as_bytes(NONCES[0]), None) for j in (3, 4, 5)]
RULES = replace(line_rules(alpha=4.0, largest_input=5.0), schedule=SCHEDULE)


def sender(record: SenderRecord, **step: Any) -> ControllerCore:
    draws = iter(NONCES[2:])
    return ControllerCore(
        RULES,
        lambda x: ((0.0,), (1.0,)),
        OneMessage(),
        Zeros(),
        instance=OTHER,
        period_s=PERIOD_S,
        record=record,
        contributions=ROWS,
        nonces=lambda: next(draws),
        **step,
    )


def receiver(record: ReceiverRecord, word: Measurement | None = None) -> PlantCore:
    draws = iter(NONCES[2:])
    step: dict[str, Any] = {"offer": offer(), "tossed": 0, "report": word} if word else {}
    line = ScriptedLine()
    return PlantCore(
        RULES,
        line,
        line,
        line.fall_back,
        Pacing(None, 4, 0.0),
        lambda: OTHER,
        0.0,
        instance=OTHER,
        record=record,
        contributions=ROWS,
        nonces=lambda: next(draws),
        **step,
    )


AS_SENDER = SenderRecord(session=S, transitions=6, block=0, tag=TAG)
AS_RECEIVER = ReceiverRecord(S, 9, (0.0,), (0.0,), transitions=6, block=0, tag=TAG)


@pytest.mark.parametrize(
    ("begun", "word"),
    [
        (lambda: sender(AS_SENDER), (0, TAG)),
        (
            lambda: sender(AS_SENDER, offer=offer(block=1, tag=TAG), measurement=said(-1, NO_TAG)),
            (1, TAG),
        ),
        (lambda: receiver(AS_RECEIVER), (0, TAG)),
        (lambda: receiver(AS_RECEIVER, said(1, TAG)), (1, TAG)),
    ],
    ids=["sender", "sender with a step", "receiver", "receiver with a step"],
)
def test_an_end_goes_on_with_its_last_word_and_its_rows(
    begun: Callable[[], ControllerCore | PlantCore], word: tuple[int, str]
) -> None:
    keying = begun().keying
    assert keying.announcement() == word
    assert keying.nonce() == NONCES[2]
    keying.count(6, 1, offer(), 0, NONCES[1])
    (closed,) = keying.tasks()
    assert isinstance(closed, ClosedBlock)
    assert (closed.session, closed.number, closed.counted) == (S, 1, 5)


def test_a_record_without_a_word_says_that_there_is_none() -> None:
    assert receiver(AS_RECEIVER._replace(tag="")).record.tag == NO_TAG
    assert receiver(AS_RECEIVER).record.tag == TAG
    assert sender(SenderRecord()).keying.blocks is None
