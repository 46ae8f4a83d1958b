"""An end's folder is put back, again and again, and a wrong end that this catches.

Both ends of `sealed`, their coin keyed too, with their files on disk, in virtual time. Either end's
folder is copied at some instant, the loop goes on, the end is killed, and the copy takes its
folder's place. Looked at is every offer on the wire: no position of the key stream belongs to two
steps, and none lies before one that was named.
"""

import random
import shutil
from collections import Counter
from pathlib import Path

import pytest

from tests.support.pair import SIDES, Name
from tests.support.recorded_pair import RecordedPair
from tests.support.size import size

COINED = '\n[defence]\ncoin = "keys"\n'
MESSAGE = bytes(range(256)) * 4
"""Longer than any run, so that there is always something to send."""

BEFORE = (20, 120)
"""Steps from one copy to the next, at least and at most: a first key takes 48."""

SINCE = (0, 1, 2, 5, 30, 100)
"""Steps that the end makes after the copy, and that are then lost."""


class Wire(RecordedPair):
    """A loop of which every offer is looked at."""

    def __init__(self, folder: Path) -> None:
        self.counts: Counter[str] = Counter()
        super().__init__(folder / "run", MESSAGE, name="sealed", more=COINED)
        self._copied = folder / "copy"

    def go_on(self, steps: int) -> None:
        target = self.plant.state.link.k + steps
        self.run(lambda: self.plant.state.link.k >= target)

    def put_back(self, side: Name, since: int) -> None:
        """Copy an end's folder, go on, kill the end, and begin again with the copy."""
        shutil.copytree(self.folder / side, self._copied)
        before = self.plant.state.record.session.id
        self.go_on(since)
        self.kill(side)
        shutil.rmtree(self.folder / side)
        self._copied.rename(self.folder / side)
        self.start(side)
        self.go_on(3)
        self.counts[side] += 1
        self.counts["sessions ended"] += self.plant.state.record.session.id != before


def restored(folder: Path, count: int) -> Wire:
    """So many restorations of one loop."""
    draw = random.Random(1)
    loop = Wire(folder)
    for _ in range(count):
        loop.go_on(draw.randint(*BEFORE))
        loop.put_back(draw.choice(SIDES), draw.choice(SINCE))
    loop.stop()
    return loop


@pytest.mark.long
def test_no_digit_is_named_for_two_steps_whoever_is_put_back(tmp_path: Path) -> None:
    loop = restored(tmp_path, size(12, 200))
    assert min(loop.counts[side] for side in SIDES) > 2
    assert len(loop.onlooker.digits.positions) > 200
    assert loop.counts["sessions ended"] > 4
