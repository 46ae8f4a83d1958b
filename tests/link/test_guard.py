"""One direction's messages under keys: the bytes that leave, and what comes of those that come."""

from random import Random
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pydantic_core import from_json, to_json

from protocol.defence.base import Defence, Opened, Wire, Words
from protocol.defence.coding import Coding
from protocol.defence.mac import Mac, tag_of
from protocol.link import guard as module
from protocol.link.guard import Guard, Promise
from protocol.messages import Measurement
from protocol.secret.tasks import Batch

S = "1" * 16
FIRST = 10
"""The step with which batch 0 begins; a batch has 8 words."""


class Shifting(Defence):
    """Moves a reading by the step and by its key, so that whoever takes other ones is seen."""

    codes: ClassVar[bool] = True
    session_words = 1
    step_words = 1

    def encode(self, k: int, session: Words, step: Any, x: Any) -> Wire:
        return Wire(x + float(k + session[0] % 97 + step[0] % 89))

    def decode(self, k: int, session: Words, step: Any, wire: Wire) -> Opened:
        shift = float(k + session[0] % 97 + step[0] % 89)
        return Opened(wire.values - shift, np.zeros((), bool))


MAC, CODE = Mac(2, 4), Shifting(2, 4)
SLOTS = 6
"""Messages under a batch, a word being its session's and one its farewell's."""


def batch(number: int, first: int = -1) -> Batch:
    return Batch(number, Random(number).randbytes(4 * 8), first)


def words(number: int) -> Any:
    return np.frombuffer(batch(number).key, ">u4").astype(np.uint32)


def sending(defence: Defence = MAC, topic: str = "measurement") -> Guard:
    """With batches 0 and 1."""
    guard = Guard(defence, topic)
    guard.add((batch(0, FIRST), batch(1, FIRST + SLOTS)))
    return guard


def hearing(defence: Defence = MAC, topic: str = "measurement", number: int = 2) -> Guard:
    guard = Guard(defence, topic)
    guard.add(tuple(batch(n) for n in range(number)))
    return guard


def measurement(k: int, applied_k: int | None = None, **more: Any) -> bytes:
    applied = k - 1 if applied_k is None else applied_k
    return Measurement(
        session=S, k=k, x=state(k), applied_k=applied, x_after=state(applied + 1), **more
    ).wire()


def state(k: int) -> tuple[float, float]:
    return (0.1 + k, -2.3 * k)


# --- which steps are covered ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("defence", "topic", "codes", "tags"),
    [
        (MAC, "measurement", False, True),
        (MAC, "offer", False, True),
        (CODE, "measurement", True, False),
        (CODE, "offer", False, False),
    ],
)
def test_measurements_are_coded_and_both_are_tagged(
    defence: Defence, topic: str, codes: bool, tags: bool
) -> None:
    guard = Guard(defence, topic)
    assert (guard.codes, guard.tags, guard.on) == (codes, tags, codes or tags)


def test_batches_are_known_by_number_and_cover_their_steps() -> None:
    guard = Guard(MAC, "measurement")
    assert (guard.newest, guard.oldest, guard.end) == (-1, 0, 0)
    guard.add((batch(3, FIRST),))
    guard.add((batch(4, FIRST + SLOTS + 2),))
    assert (guard.newest, guard.oldest, guard.end) == (4, 3, FIRST + 2 * SLOTS + 2)
    last = FIRST + SLOTS - 1
    covered = {k: guard.covers(k) for k in (FIRST - 1, FIRST, last, last + 1, last + 3)}
    assert covered == {FIRST - 1: -1, FIRST: 3, last: 3, last + 1: -1, last + 3: 4}
    assert [guard.until(k) for k in (FIRST - 1, FIRST, last, last + 1)] == [
        FIRST - 2,
        last,
        last,
        last,
    ]
    assert guard.until(last + 3) == FIRST + 2 * SLOTS + 1
    guard.drop_below(3)
    assert guard.oldest == 3
    guard.drop_below(4)
    assert (guard.newest, guard.oldest, guard.end) == (4, 4, FIRST + 2 * SLOTS + 2)
    guard.begin()
    assert (guard.newest, guard.oldest, guard.end) == (-1, 0, 0)


def test_batches_that_follow_each_other_cover_all_steps() -> None:
    assert sending().until(FIRST) == FIRST + 2 * SLOTS - 1


# --- what leaves ----------------------------------------------------------------------------------


def tag(said: bytes, number: int, slot: int) -> bytes:
    """The tag by its definition: of the direction, the bytes, and how many they are."""
    key = words(number)
    padded = said + bytes(-len(said) % 4)
    text = np.append(np.frombuffer(padded, ">u4").astype(np.uint32), np.uint32(len(said)))
    return b"%08x" % int(tag_of(key[0], key[1 + slot], text))


@pytest.mark.parametrize("topic", ["measurement", "offer"])
@pytest.mark.parametrize("k", [FIRST, FIRST + 3, FIRST + SLOTS - 1, FIRST + SLOTS])
def test_a_tagged_message_names_its_key_and_ends_with_its_tag(k: int, topic: str) -> None:
    number, slot = divmod(k - FIRST, SLOTS)
    plain = measurement(k)
    anew = b'"copy_number":0,"nonce":"",'
    assert plain.count(anew) == 1
    body = plain[:-1] + b',"guard":"%d/%d"' % (number, slot)
    covered = topic.encode() + body.replace(anew, b"")
    expected = body + b',"mac":"' + tag(covered, number, slot) + b'"}'
    assert sending(topic=topic).closed(k, plain) == expected


def test_before_the_first_batch_a_message_is_bare_and_after_the_last_it_says_farewell() -> None:
    guard = sending()
    early = measurement(FIRST - 1)
    assert guard.closed(FIRST - 1, early) == early
    for k in (FIRST + 2 * SLOTS, FIRST + 2 * SLOTS + 9):
        plain = measurement(k)
        said = tag(b"measurementfarewell 1", 1, SLOTS)
        assert guard.closed(k, plain) == plain[:-1] + b',"guard":"1/","mac":"' + said + b'"}'
    between = Guard(MAC, "measurement")
    between.add((batch(0, FIRST), batch(1, FIRST + SLOTS + 1)))
    assert b'"guard":"0/","mac"' in between.closed(FIRST + SLOTS, measurement(FIRST + SLOTS))


def test_coded_messages_have_no_farewell() -> None:
    plain = measurement(FIRST + 2 * SLOTS)
    assert sending(CODE).closed(FIRST + 2 * SLOTS, plain) == plain


def shift(k: int) -> float:
    number, slot = divmod(k - FIRST, SLOTS)
    key = words(number)
    return float(k + key[0] % 97 + key[1 + slot] % 89)


def moved(k: int) -> list[float]:
    return [v + shift(k) for v in state(k)]


@pytest.mark.parametrize(
    ("k", "applied", "after"),
    [
        (FIRST + 2, FIRST + 1, ""),
        (FIRST + 4, FIRST + 1, "0/2"),
        (FIRST + SLOTS + 1, FIRST + 1, "0/2"),
        (FIRST + 2, FIRST - 1, "0/0"),
    ],
)
def test_each_state_is_coded_under_the_key_of_its_own_step(
    k: int, applied: int, after: str
) -> None:
    wire = sending(CODE).closed(k, measurement(k, applied), applied + 1)
    said = from_json(wire)
    assert said["x"] == moved(k)
    assert said["x_after"] == moved(applied + 1)
    number, slot = divmod(k - FIRST, SLOTS)
    assert (said["guard"], said["after"]) == (f"{number}/{slot}", after)
    assert len(said["rest"]) == (4 if after else 2)
    assert "mac" not in said


@pytest.mark.parametrize("after_k", [FIRST - 1, -1])
def test_a_state_before_the_first_batch_stays_as_it_left_then(after_k: int) -> None:
    plain = measurement(FIRST + 1, FIRST - 2)
    said = from_json(sending(CODE).closed(FIRST + 1, plain, after_k))
    assert (tuple(said["x_after"]), said["after"]) == (state(FIRST - 1), "")
    assert said["x"] == moved(FIRST + 1)


def test_where_nothing_was_applied_yet_nothing_is_coded_in_its_place() -> None:
    plain = Measurement(session=S, k=FIRST, x=state(FIRST), applied_k=-1, x_after=()).wire()
    for after_k in (FIRST, -1):
        said = from_json(sending(CODE).closed(FIRST, plain, after_k))
        assert (said["x"], said["x_after"], said["after"]) == (moved(FIRST), [], "")


# --- what comes of it -----------------------------------------------------------------------------

NONE = Promise()


@pytest.mark.parametrize("defence", [MAC, CODE])
@pytest.mark.parametrize(("k", "needs"), [(FIRST, 0), (FIRST + 5, 0), (FIRST + SLOTS + 2, 1)])
def test_what_was_closed_opens_as_it_was(defence: Defence, k: int, needs: int) -> None:
    plain = measurement(k)
    opened = hearing(defence).opened(k, sending(defence).closed(k, plain, k), NONE)
    assert opened.plain is not None
    assert from_json(opened.plain) == from_json(plain)
    assert opened == module.Opened(opened.plain, *divmod(k - FIRST, SLOTS), needs)


def test_a_plain_body_is_passed_on_to_the_byte() -> None:
    plain = measurement(FIRST)
    opened = hearing().opened(FIRST, sending().closed(FIRST, plain), NONE)
    assert opened == module.Opened(plain, 0, 0, 0)


def test_a_state_under_an_older_batch_says_that_it_is_needed() -> None:
    k, applied = FIRST + SLOTS + 1, FIRST + 1
    wire = sending(CODE).closed(k, measurement(k, applied), applied + 1)
    opened = hearing(CODE).opened(k, wire, NONE)
    assert opened.plain is not None
    assert (opened.number, opened.slot, opened.needs) == (1, 1, 0)
    said = from_json(opened.plain)
    assert (tuple(said["x"]), tuple(said["x_after"])) == (state(k), state(applied + 1))


@pytest.mark.parametrize("topic", ["measurement", "offer"])
def test_a_tag_is_of_the_whole_message_and_of_its_direction(topic: str) -> None:
    wire = sending(topic=topic).closed(FIRST, measurement(FIRST))
    other = hearing(topic="offer" if topic == "measurement" else "measurement")
    forged = module.Opened(None, why="its tag is wrong")
    assert other.opened(FIRST, wire, NONE) == forged
    guard = hearing(topic=topic)
    assert guard.opened(FIRST, wire, NONE).plain is not None
    changed = [
        wire.replace(b'"k":10', b'"k":11'),
        wire.replace(b"10.1", b"10.2", 1),
        wire.replace(b'"guard":"0/0"', b'"guard":"0/1"'),
        wire.replace(b'"guard":"0/0"', b'"guard":"1/0"'),
        wire.replace(b'"mac":"', b'"mac":"0')[:-3] + b'"}',
        wire.replace(b'"mac"', b'"nac"'),
        wire[: wire.index(b',"mac"')] + b"}",
    ]
    assert [guard.opened(FIRST, text, NONE) for text in changed] == [forged] * len(changed)


def test_a_tag_leaves_copy_and_nonce_open_and_nothing_else() -> None:
    wire = sending().closed(FIRST, measurement(FIRST))
    again = measurement(FIRST, copy_number=1, nonce="A" * 43 + "=")
    body = again[:-1] + wire[wire.index(b',"guard"') :]
    opened = hearing().opened(FIRST, body, NONE)
    assert opened == module.Opened(again, 0, 0, 0)


def test_bytes_that_the_padding_would_hide_are_under_the_tag() -> None:
    guard, wires = sending(), set()
    for more in (b"", b"\0", b"\0\0"):
        wires.add(guard.closed(FIRST, b'{"a":1' + more + b"}")[-10:])
    assert len(wires) == 3


def test_a_bare_message_is_heard_until_one_was_promised_never_to_be() -> None:
    plain = measurement(20)
    for defence in (MAC, CODE):
        assert hearing(defence).opened(20, plain, NONE) == module.Opened(plain)
    refused = module.Opened(None, why="it has no tag")
    assert hearing().opened(20, plain, Promise(19, 0)) == refused
    assert hearing().opened(20, plain, Promise(20, 0)) == module.Opened(plain)
    assert hearing(CODE).opened(20, plain, Promise(19, 0)) == module.Opened(plain)


def test_a_promise_keeps_its_first_step_and_its_newest_batch() -> None:
    assert not NONE.refuses(5)
    first = NONE.extended(7, 2)
    assert first == Promise(7, 2)
    assert NONE.extended(7, 0) == Promise(7, 0)
    assert first.extended(9, 1) == Promise(7, 2)
    assert first.extended(9, 3) == Promise(7, 3)
    assert Promise(7, 0).extended(9, 0) == Promise(7, 0)
    assert [Promise(7, 0).refuses(k) for k in (6, 7, 8)] == [False, False, True]


def test_a_batch_that_is_not_held_is_lacking_and_one_that_has_served_is_late() -> None:
    wire = sending().closed(FIRST + SLOTS, measurement(FIRST + SLOTS))
    for held in (0, 1):
        opened = hearing(number=held).opened(FIRST + SLOTS, wire, NONE)
        assert opened == module.Opened(None, lacking=1)
    guard = hearing()
    first = sending().closed(FIRST, measurement(FIRST))
    guard.drop_below(1)
    assert guard.opened(FIRST, first, NONE) == module.Opened(None)
    guard.drop_below(2)
    assert guard.opened(FIRST, first, NONE) == module.Opened(None, lacking=0)


def test_a_slot_that_the_batch_does_not_have_is_no_message() -> None:
    wire = sending().closed(FIRST, measurement(FIRST))
    beyond = wire.replace(b'"guard":"0/0"', b'"guard":"0/%d"' % (SLOTS + 1))
    assert hearing().opened(FIRST, beyond, NONE) == module.Opened(None, lacking=0)
    last = wire.replace(b'"guard":"0/0"', b'"guard":"0/%d"' % SLOTS)
    assert hearing().opened(FIRST, last, NONE) == module.Opened(None, why="its tag is wrong")


def test_a_farewell_is_heard_of_the_newest_batch_alone() -> None:
    k = FIRST + 2 * SLOTS
    plain = measurement(k)
    wire = sending().closed(k, plain)
    for promise in (NONE, Promise(FIRST, 0), Promise(FIRST, 1)):
        assert hearing().opened(k, wire, promise) == module.Opened(plain, 1, needs=1)
    assert hearing().opened(k, wire, Promise(FIRST, 2)) == module.Opened(None, 1, needs=1)
    forged = wire.replace(b'"mac":"', b'"mac":"f')[:-3] + b'"}'
    assert hearing().opened(k, forged, NONE).why == "its tag is wrong"
    stolen = plain[:-1] + wire[wire.index(b',"guard"') :].replace(b'"1/"', b'"0/"')
    assert hearing().opened(k, stolen, NONE).why == "its tag is wrong"
    coded = plain[:-1] + b',"guard":"1/","after":"","rest":[0,0]}'
    assert hearing(CODE).opened(k, coded, NONE) == module.Opened(None, why="it does not open")


K, APPLIED = FIRST + 4, FIRST + 1
CLOSED = from_json(sending(CODE).closed(K, measurement(K, APPLIED), APPLIED + 1))
TAIL = ("guard", "after", "rest")


def rewritten(**fields: Any) -> bytes:
    """The coded message with other fields; its last ones stay the last."""
    said = CLOSED | fields
    ordered = {n: v for n, v in said.items() if n not in TAIL} | {
        n: said[n] for n in TAIL if said[n] is not None
    }
    return to_json(ordered)


SPOILS: list[dict[str, Any]] = [
    {"rest": [0, 0, 0]},
    {"rest": [0]},
    {"rest": [[0, 0], [0, 0]]},
    {"rest": []},
    {"rest": None},
    {"rest": [0, 0]},
    {"rest": [0, 0, -1, 0]},
    {"rest": [0, 0, 2**64, 0]},
    {"rest": "abcd"},
    {"after": None},
    {"after": "0"},
    {"after": "0/1/2"},
    {"after": "a/b"},
    {"after": 3},
    {"after": ["0/2"]},
    {"x": [1.0]},
    {"x": [1.0, 2.0, 3.0]},
    {"x": [[1.0, 2.0]]},
    {"x": "no"},
    {"x_after": ["a", "b"]},
    {"applied_k": "no"},
]


def test_the_coded_message_opens_where_nothing_is_spoiled() -> None:
    opened = hearing(CODE).opened(K, rewritten(), NONE)
    assert opened.plain is not None
    said = from_json(opened.plain)
    assert (tuple(said["x"]), tuple(said["x_after"])) == (state(K), state(APPLIED + 1))
    assert (opened.number, opened.slot, opened.needs) == (0, 4, 0)
    assert not {"after", "rest", "guard"} & set(said)


@pytest.mark.parametrize("spoils", SPOILS, ids=str)
def test_a_coded_message_that_is_spoiled_does_not_open(spoils: dict[str, Any]) -> None:
    assert hearing(CODE).opened(K, rewritten(**spoils), NONE) == module.Opened(
        None, why="it does not open"
    )


def test_a_state_whose_batch_has_served_is_late_and_one_to_come_does_not_open() -> None:
    k, applied = FIRST + SLOTS + 1, FIRST + 1
    wire = sending(CODE).closed(k, measurement(k, applied), applied + 1)
    guard = hearing(CODE)
    guard.drop_below(1)
    assert guard.opened(k, wire, NONE) == module.Opened(None)
    later = wire.replace(b'"after":"0/2"', b'"after":"7/2"')
    assert hearing(CODE).opened(k, later, NONE) == module.Opened(None, why="it does not open")


def test_a_state_that_was_not_coded_is_left_as_it_is() -> None:
    plain = measurement(FIRST + 1, FIRST - 2)
    wire = sending(CODE).closed(FIRST + 1, plain, FIRST - 1)
    opened = hearing(CODE).opened(FIRST + 1, wire, NONE)
    assert opened.plain is not None
    assert from_json(opened.plain) == from_json(plain)
    nothing = Measurement(session=S, k=FIRST, x=state(FIRST), applied_k=-1, x_after=()).wire()
    wire = sending(CODE).closed(FIRST, nothing, -1)
    opened = hearing(CODE).opened(FIRST, wire, NONE)
    assert opened.plain is not None
    assert from_json(opened.plain) == from_json(nothing)


@pytest.mark.parametrize(("kind", "heard"), [(MAC, True), (CODE, False)], ids=["tagged", "coded"])
def test_without_its_batch_a_tagged_message_counts_as_bare(kind: Defence, heard: bool) -> None:
    plain = measurement(FIRST)
    wire = sending(kind).closed(FIRST, plain, FIRST)
    guard = hearing(kind, number=0)
    assert guard.without(FIRST, wire, NONE) == module.Opened(plain if heard else None)
    assert guard.without(FIRST, plain, NONE) == module.Opened(None), "it is not asked of those"
    if heard:
        refused = guard.without(FIRST, wire, Promise(FIRST - 1, 0))
        assert refused == module.Opened(None, why="it has no tag")


PLACES = st.sampled_from(["", "0/0", "0/2", "1/1", "-1/0", "0/-3", "0/9999999999", "1/2/3", "a"])
FLOATS = st.floats(-1e300, 1e300)
PAIRS = st.lists(st.integers(0, 2**64 - 1) | FLOATS, min_size=2, max_size=4)
JSON = st.recursive(
    PLACES | PAIRS | st.none() | st.booleans() | st.integers() | FLOATS,
    lambda some: st.lists(some, max_size=4) | st.dictionaries(st.text(max_size=3), some),
)
NAMES = st.sampled_from(["x", "x_after", "applied_k", "k", "session", "after", "rest"])


@given(st.dictionaries(NAMES, JSON, min_size=1))
@example({"after": [1]})
@example({"applied_k": 10**400})
def test_whatever_stands_in_a_coded_message_it_is_opened_or_refused(odd: dict[str, Any]) -> None:
    coded = sending(Coding(2, 4)).closed(FIRST, measurement(FIRST))
    fields = from_json(coded) | odd
    body = to_json({name: value for name, value in fields.items() if name not in TAIL})
    more = to_json({"after": fields["after"], "rest": fields["rest"]})
    wire = body[:-1] + b',"guard":"0/0",' + more[1:]
    opened = hearing(Coding(2, 4)).opened(FIRST, wire, NONE)
    assert (opened.plain is None) == bool(opened.why or opened.lacking >= 0)
