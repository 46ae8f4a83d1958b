"""What one end does for keys: blocks that give none, and what is saved once."""

import pytest

from protocol.link.distiller import NO_ROWS, BlockEnded, Distiller
from protocol.link.records import KeyRecord
from protocol.messages import Measurement
from protocol.secret.blocks import ClosedBlock, Schedule
from protocol.secret.bound import Assumption
from protocol.secret.extractor import extracted
from protocol.secret.key_digits import digits
from protocol.secret.nonces import Contribution
from protocol.secret.stream import Keys
from runtime.chance import fresh_nonce

S = "1" * 16
SCHEDULE = Schedule(Assumption(0.95, eps_sec=1e-2), first=3, largest=6)


def row(j: int, *, lost: bool = False) -> Contribution:
    """A transition's row; ``lost``: no copy of it counts."""
    return Contribution(j, 1, None if lost else bytes([j]) * 32, None if lost else b"m" * 32)


def begun(until: int, **more: bool) -> Distiller:
    keys = Distiller(SCHEDULE, 2, fresh_nonce)
    keys.resume(S, KeyRecord(), rows=[row(j, **more) for j in range(1, until)])
    return keys


def said(tag: str) -> Measurement:
    return Measurement(
        session=S, k=9, x=(0.0,), applied_k=8, x_after=(0.0,), block=0, tag=tag, nonce=fresh_nonce()
    )


def closed(keys: Distiller) -> ClosedBlock:
    (task,) = keys.tasks()
    assert keys.tasks() == (), "it is asked for once"
    return task


def test_equal_tags_give_the_keys_once() -> None:
    keys = begun(4)
    block = extracted(closed(keys))
    keys.extracted(block)
    keys.compare(said(block.tag))
    keys.compare(said(block.tag))
    assert keys.ended() == (BlockEnded(S, 0, "confirmed", len(block.keys)),)
    rows = keys.rows()
    assert rows.keys == (Keys(0, 0, b"".join(block.keys)),)
    assert keys.stream.left == sum(len(digits(key, 2)) for key in block.keys)
    assert keys.rows().keys == ()


def test_unequal_tags_give_no_key_whatever_comes_after() -> None:
    keys = begun(4)
    block = extracted(closed(keys))
    keys.extracted(block)
    keys.compare(said("c" * 32))
    keys.compare(said(block.tag))
    assert keys.ended() == (BlockEnded(S, 0, "unequal"),)
    assert (keys.stream.left, keys.made, keys.rows().keys) == (0, 0, ())


def test_a_block_that_lost_too_many_copies_is_not_extracted_and_its_rows_go() -> None:
    keys = begun(4, lost=True)
    assert keys.tasks() == ()
    assert keys.ended() == (BlockEnded(S, 0, "poor"),)
    assert keys.rows().obsolete_rows == (range(1, 4),)
    assert keys.rows() == NO_ROWS
    assert keys.announcement() == (-1, keys.no_tag)


@pytest.mark.parametrize("early", [True, False])
def test_once_it_has_failed_no_block_is_extracted_announced_or_confirmed(early: bool) -> None:
    keys = begun(5)
    if early:
        keys.fail("refuted")
        assert keys.tasks() == ()
        return
    block = extracted(closed(keys))
    keys.extracted(block)
    keys.fail("refuted")
    keys.fail("again")
    assert keys.broken == "refuted"
    assert keys.announcement() == (-1, keys.no_tag)
    keys.compare(said(block.tag))
    assert keys.stream.left == 0
