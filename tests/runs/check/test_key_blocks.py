"""The checks of keys one by one: what they count, what they find, and how they say it."""

from types import SimpleNamespace
from typing import Any, cast

import pytest

from tests.runs.check.judged import SCHEDULE, evidence, heard, judge
from wyner.runs.check import key_blocks
from wyner.runs.check.base import Check, Counter, Place
from wyner.runs.check.capture import CapturedMessage
from wyner.runs.check.evidence import Pair, Part
from wyner.runs.check.records import (
    BlockLine,
    Item,
    OtherLine,
    SessionLine,
    TracedTransition,
    Walked,
)

A, B = "a" * 16, "b" * 16


def told(number: int, topic: str, k: int, session: str = A, /, **message: Any) -> CapturedMessage:
    return CapturedMessage("capture.jsonl", number, b"", topic, session, k, message)


def walked(j: int, counts: int, k: int | None = None, session: str = A) -> Walked:
    t = TracedTransition.__new__(TracedTransition)  # its other fields are other checks'
    fields = {"session": session, "j": j, "k": j if k is None else k, "counts": counts}
    for name, value in fields.items():
        object.__setattr__(t, name, value)
    return Walked(t, cast(Any, None), cast(Any, None), 1)


def first(k: int, text: str, *, session: str = A, j: int = -1) -> Place:
    return Place(session, j, k, text)


# --- nonces and copies ----------------------------------------------------------------------------


def test_a_nonce_leaves_once() -> None:
    part = heard(told(2, "offer", 5, nonce="p"), told(3, "offer", 6, nonce="q"))
    assert judge(key_blocks.NonceOnce, evidence(), part) == Counter(2)
    again = heard(told(4, "measurement", 7, nonce="p"), told(5, "offer", 8, nonce="p"))
    text = "capture.jsonl line 4: measurement 7 carries a nonce that was there before"
    assert judge(key_blocks.NonceOnce, evidence(), part, again) == Counter(4, 2, first(7, text))


def test_copy_0_leaves_once_a_step_and_a_session() -> None:
    part = heard(
        told(2, "offer", 5, copy_number=0),
        told(3, "offer", 5, copy_number=1),
        told(4, "measurement", 5, copy_number=0),
        told(5, "offer", 5, B, copy_number=0),
        told(6, "offer", 6, copy_number=0),
    )
    assert judge(key_blocks.Copy0Once, evidence(), part) == Counter(4)
    again = heard(told(7, "offer", 5, copy_number=0))
    text = "capture.jsonl line 7: a second copy 0 of offer 5"
    found = judge(key_blocks.Copy0Once, evidence(), part, again)
    assert found == Counter(5, 1, first(5, text))


def test_a_field_of_another_type_is_another_checks_matter() -> None:
    strange: list[object] = [[1], {}, "2", None, 1.5]
    for value in strange:
        fields = ("nonce", "copy_number", "applied_k", "applied_copy", "heard", "block", "tag")
        message: dict[str, Any] = dict.fromkeys(fields, value)
        seen = [told(2, topic, 5, **message) for topic in ("offer", "measurement")]
        for check in (key_blocks.Copy0Once, key_blocks.Counted, key_blocks.Tags):
            assert judge(check, evidence(), heard(*seen)).failures == 0
        assert judge(key_blocks.NonceOnce, evidence(), heard(*seen)).failures == 1


@pytest.mark.parametrize(
    ("check", "without", "said"),
    [
        (key_blocks.NonceOnce, {"wire": None}, "no capture in this run's folder"),
        (key_blocks.Copy0Once, {"wire": None}, "no capture in this run's folder"),
        (key_blocks.Tags, {"wire": None}, "no capture in this run's folder"),
        (key_blocks.Counted, {"plant": None}, "no plant trace in this run's folder"),
        (key_blocks.Blocks, {"plant": None}, "no plant trace in this run's folder"),
        (key_blocks.Blocks, {"controller": None}, "no controller trace in this run's folder"),
    ],
)
def test_what_is_not_there_is_not_judged(
    check: type[Check], without: dict[str, Any], said: str
) -> None:
    part = heard(told(2, "offer", 5, nonce="p"), told(3, "offer", 5, nonce="p"))
    assert judge(check, evidence(**without), part) == Counter(skipped=said)


# --- counts ---------------------------------------------------------------------------------------


def test_both_ends_count_alike() -> None:
    alike = Part([], [], [Pair(walked(1, 3), walked(1, 3)), Pair(walked(2, 2), None)], [])
    assert judge(key_blocks.Counted, evidence(), alike) == Counter(1)
    unlike = Part([], [], [Pair(None, walked(3, 1)), Pair(walked(4, 2, 7), walked(4, 3, 7))], [])
    text = "the plant counts 2, the controller 3"
    assert judge(key_blocks.Counted, evidence(), alike, unlike) == Counter(
        2, 1, first(7, text, j=4)
    )


def test_a_copy_that_was_named_later_than_0_does_not_count() -> None:
    """The plant counts both copies of 5, 6's offer, 7's measurement, and none of 8."""
    pairs = [Pair(walked(j, c, j + 4), None) for j, c in ((0, 3), (1, 3), (2, 1), (3, 2), (4, 0))]
    counting = Part([], [], pairs, [])

    def found(*seen: CapturedMessage) -> Counter:
        return judge(key_blocks.Counted, evidence(), counting, heard(*seen))

    for seen in (
        told(2, "measurement", 6, applied_k=5, applied_copy=0),
        told(2, "measurement", 8, applied_k=7, applied_copy=2),  # its offer's copy is not counted
        told(2, "measurement", 9, applied_k=8, applied_copy=2),
        told(2, "measurement", 6, B, applied_k=5, applied_copy=2),
        told(2, "measurement", 6, applied_copy=2),
        told(2, "measurement", 5, applied_k=4, applied_copy=2),  # the session's first
        told(2, "offer", 5, heard=0),
        told(2, "offer", 6, heard=3),
        told(2, "offer", 5, heard=None),
        told(2, "offer", 70, heard=3),
    ):
        assert found(seen) == Counter(1), seen
    old = told(2, "offer", 5, heard=2)._replace(part="too-old.jsonl")
    assert found(old, told(3, "offer", 5, heard=0)) == Counter(1)
    text = "capture.jsonl line 3: copy 2 was taken, and the plant counts 3"
    late = told(3, "measurement", 6, applied_k=5, applied_copy=2)
    assert found(late) == Counter(1, 1, first(5, text, j=1))
    late = told(3, "offer", 7, heard=2)
    text = "capture.jsonl line 3: copy 2 was taken, and the plant counts 2"
    assert found(late) == Counter(1, 1, first(7, text, j=3))


# --- blocks ---------------------------------------------------------------------------------------


def stored(number: int, keys: int, session: str = A) -> OtherLine:
    return OtherLine(BlockLine("block", session, number, "confirmed", keys), b"")


def block_items(number: int, keys: int, counts: int = 3, session: str = A) -> list[Item]:
    begins, length = SCHEDULE.begins(number), SCHEDULE.length(number)
    items: list[Item] = [walked(j, counts, session=session) for j in range(begins, begins + length)]
    return [*items, stored(number, keys, session)]


def rows(number: int, *, missed: int = 0, counted: int | None = None) -> int:
    n = SCHEDULE.length(number)
    return SCHEDULE.assumption.rows(n, n + missed, 2 * n if counted is None else counted)


def test_blocks_make_what_their_transitions_allow() -> None:
    keys = [rows(0) - 1, rows(1) - 1, rows(2) - 1]
    assert keys[0] > 0
    assert keys[1] == keys[2] > keys[0]
    start: list[Item] = [walked(0, 3)]
    items = [*start, *block_items(0, keys[0]), *block_items(1, keys[1])]
    found = judge(key_blocks.Blocks, evidence(), Part(items, items, [], []))
    made = sum(keys[:2])
    assert found == Counter(6, note=f"{made} keys made of 2 blocks at the plant")
    more = block_items(2, keys[2])
    found = judge(key_blocks.Blocks, evidence(), Part(items, items, [], []), Part(more, [], [], []))
    assert found == Counter(7, note=f"{made + keys[2]} keys made of 3 blocks at the plant")


def test_a_block_with_too_many_keys_fails_at_its_end() -> None:
    right, wrong = rows(0) - 1, rows(0)
    honest: list[Item] = [walked(0, 3, session=B), *block_items(0, right, session=B)]
    items = [walked(0, 3, session=B), *block_items(0, wrong, session=B)]
    found = judge(key_blocks.Blocks, evidence(), Part(items, honest, [], []))
    text = f"the plant made {wrong} keys of block 0, expected {right}"
    note = f"{wrong} keys made of 1 blocks at the plant"
    assert found == Counter(3, 2, first(-1, text, session=B), note)
    found = judge(key_blocks.Blocks, evidence(), Part(honest, items, [], []))
    assert found.first == first(-1, text.replace("plant", "controller"), session=B)


def test_ends_that_made_other_numbers_of_a_block_fail() -> None:
    """One of them says that it made none."""
    start: list[Item] = [walked(0, 3)]
    some, none = ([*start, *block_items(0, keys)] for keys in (rows(0) - 1, 0))
    found = judge(key_blocks.Blocks, evidence(), Part(some, none, [], []))
    text = f"block 0: {rows(0) - 1} keys at the plant, 0 at the controller"
    note = f"{rows(0) - 1} keys made of 1 blocks at the plant"
    alone = f"the controller made 0 keys of block 0, expected {rows(0) - 1}"
    assert found == Counter(3, 2, first(-1, alone), note)
    assert text.startswith("block 0")
    assert judge(key_blocks.Blocks, evidence(), Part(none, none, [], [])).failures == 2


def test_missed_steps_and_uncounted_copies_cost_rows() -> None:
    """Two steps missed within block 1; its last transition's copies were not counted."""
    start: list[Item] = [walked(0, 3), *block_items(0, rows(0) - 1)]
    begins = SCHEDULE.begins(1)
    late: list[Item] = [walked(j, 3, j + 2 * (j > begins)) for j in range(begins, begins + 7)]
    late.append(walked(begins + 7, 0, begins + 9))
    expected = rows(1, missed=2, counted=14) - 1
    assert 0 <= expected < rows(1) - 3
    for keys, failures in ((expected, 0), (expected + 1, 2)):
        items = [*start, *late, stored(1, keys)]
        found = judge(key_blocks.Blocks, evidence(), Part(items, items, [], []))
        assert (found.counted, found.failures) == (6, failures if keys else 0)


def test_a_gap_before_the_sessions_first_transition_is_no_missed_step() -> None:
    items: list[Item] = [walked(0, 3, 100)]
    items += [walked(j, 3, 100 + j) for j in range(1, 5)]
    items.append(stored(0, rows(0) - 1))
    assert judge(key_blocks.Blocks, evidence(), Part(items, items, [], [])).failures == 0


def test_a_trace_that_begins_within_a_session_counts_from_there() -> None:
    items: list[Item] = [walked(j, 3, 50 + j) for j in range(1, 5)]
    items.append(stored(0, rows(0, missed=-1) - 1))
    assert judge(key_blocks.Blocks, evidence(), Part(items, items, [], [])).failures == 0


def test_a_block_that_is_not_whole_makes_no_key() -> None:
    alone: list[Item] = [stored(0, 1)]
    for items in (block_items(0, 1)[1:], alone):
        found = judge(key_blocks.Blocks, evidence(), Part(items, [], [], []))
        assert found.first == first(-1, "the plant made 1 keys of block 0, expected None")
    poor: list[Item] = block_items(0, 1, counts=0)
    found = judge(key_blocks.Blocks, evidence(), Part(poor, [], [], []))
    assert found.first == first(-1, "the plant made 1 keys of block 0, expected 0")


def test_a_block_that_began_before_what_is_left_of_a_trace_is_not_judged() -> None:
    items: list[Item] = [stored(0, 5), stored(1, 5), stored(0, 5, B), *block_items(2, 0)]
    for at, expected in {None: 4, 0: 3, 3: 3, 4: 2, 11: 2, 12: 1}.items():
        cut = None if at is None else SimpleNamespace(session=A, j=at)
        judged = judge(key_blocks.Blocks, evidence(cut=cut), Part(items, [], [], []))
        assert judged.counted == expected, at


# --- tags -----------------------------------------------------------------------------------------


def test_a_block_has_one_tag_at_both_ends() -> None:
    part = heard(
        told(2, "offer", 1, block=-1, tag="0"),
        told(3, "offer", 2, block=-1, tag="1"),
        told(4, "offer", 3, block=0, tag="x"),
        told(5, "offer", 4, B, block=0, tag="y"),
        told(6, "measurement", 5, block=0, tag="x"),
        told(7, "measurement", 6, block=1, tag="z"),
        told(8, "offer", 7, block=0, tag="x"),
    )
    assert judge(key_blocks.Tags, evidence(), part) == Counter(6)
    other = heard(told(9, "offer", 8, block=0, tag="w"))
    text = "capture.jsonl line 9: block 0 has another tag than before"
    found = judge(key_blocks.Tags, evidence(), part, other)
    assert found == Counter(7, 1, first(8, text))


def test_tags_of_a_block_are_the_same_at_both_ends() -> None:
    part = heard(told(2, "offer", 1, block=3, tag="x"), told(3, "measurement", 1, block=3, tag="y"))
    expected = Counter(3, 1, first(-1, "block 3: the ends' tags differ"))
    assert judge(key_blocks.Tags, evidence(), part) == expected


# --- where no key is claimed ----------------------------------------------------------------------


def test_other_lines_are_passed_over() -> None:
    other = OtherLine(SessionLine("session", A, "met"), b"")
    items: list[Item] = [other, walked(0, 3), *block_items(0, rows(0) - 1), other]
    assert judge(key_blocks.Blocks, evidence(), Part(items, items, [], [])).failures == 0


def test_where_nothing_is_claimed_nothing_is_counted() -> None:
    e = evidence(schedule=None, keys=None)
    clean: list[Item] = [walked(1, 0), stored(0, 0)]
    part = Part(clean, clean, [], [told(2, "offer", 1, nonce="", tag=""), told(3, "offer", 2)])
    assert judge(key_blocks.RefusedAtZero, e, part) == Counter(4)
    for message in ({"nonce": "p"}, {"tag": "p"}, {"nonce": "p", "tag": "p"}):
        text = "capture.jsonl line 4: a nonce or a tag, and no key is claimed"
        found = judge(key_blocks.RefusedAtZero, e, part, heard(told(4, "offer", 3, **message)))
        assert found == Counter(5, 1, first(3, text))
    for side, trace in (("plant", 0), ("controller", 1)):
        items: list[list[Item]] = [[], []]
        items[trace] = [walked(6, 2, 8)]
        found = judge(key_blocks.RefusedAtZero, e, part, Part(items[0], items[1], [], []))
        text = f"the {side} counts copies, and no key is claimed"
        assert found == Counter(5, 1, first(8, text, j=6))
