"""An end's journal is put back, again and again.

Both ends of `sealed`, their coin keyed too, with their files on disk, in virtual time. Either end's
journal is copied at some instant, the loop goes on, the end is killed, and the copy takes its
journal's place. Every offer on the wire is looked at: no position of the key stream belongs to two
steps, and none lies before one that was named.
"""

import random
from collections import Counter
from pathlib import Path

import pytest

from tests.support.pair import SIDES
from tests.support.recorded_pair import RecordedPair
from tests.support.size import size

COINED = '\n[defence]\ncoin = "keys"\n'
MESSAGE = bytes(range(256)) * 4
"""Longer than any run, so that there is always something to send."""

BEFORE = (20, 120)
"""Steps from one copy to the next, at least and at most: a first key takes 48."""

SINCE = (0, 1, 2, 5, 30, 100)
"""Steps that the end makes after the copy, and that are then lost."""


@pytest.mark.long
def test_no_digit_is_named_for_two_steps_whoever_is_put_back(tmp_path: Path) -> None:
    draw, counts = random.Random(1), Counter[str]()
    loop = RecordedPair(tmp_path / "run", MESSAGE, name="sealed", more=COINED)
    for _ in range(size(12, 200)):
        loop.steps(draw.randint(*BEFORE))
        side = draw.choice(SIDES)
        loop.copy(side)
        session = loop.plant.state.record.session.id
        loop.steps(draw.choice(SINCE))
        loop.restart(side, "old")
        loop.steps(3)
        counts[side] += 1
        counts["sessions ended"] += loop.plant.state.record.session.id != session
    loop.stop()
    assert min(counts[side] for side in SIDES) > 2
    assert len(loop.onlooker.digits.positions) > 200
    assert counts["sessions ended"] > 4
