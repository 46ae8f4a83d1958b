"""An end's folder is put back, again and again: ``python -m tests.campaigns.restored --count 200``.

Both ends of `sealed`, their coin keyed too, with their files on disk, in virtual time. Either end's
folder is copied at some instant, the loop goes on, the end is killed, and the copy takes its
folder's place. Looked at is every offer on the wire: no position of the key stream belongs to two
steps, and none lies before one that was named.
"""

import argparse
import random
import shutil
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Final

from protocol.link.session import rules_of
from protocol.messages import Offer
from protocol.secret.stream import NOWHERE
from tests.support.mail import Mail
from tests.support.once import Digits
from tests.support.pair import SIDES, Name
from tests.support.recorded_pair import RecordedPair

COINED: Final = '\n[defence]\ncoin = "keys"\n'
MESSAGE: Final = bytes(range(256)) * 4
"""Longer than any run, so that there is always something to send."""

BEFORE: Final = (20, 120)
"""Steps from one copy to the next, at least and at most: a first key takes 48."""

SINCE: Final = (0, 1, 2, 5, 30, 100)
"""Steps that the end makes after the copy, and that are then lost."""


class Wire(RecordedPair):
    """A loop of which every offer is looked at."""

    def __init__(self, folder: Path) -> None:
        self.counts: Counter[str] = Counter()
        self.doubled: list[str] = []
        super().__init__(folder, MESSAGE, name="sealed", more=COINED)
        self._digits = Digits(rules_of(self.scenario).digits)

    def said(self, side: Name, message: Mail) -> None:
        """Look at an offer, and let it go on its way."""
        if message.kind is Offer:
            offer = Offer.model_validate_json(message.payload)
            self.counts["offers"] += 1
            self.counts["with digits"] += offer.position != NOWHERE
            try:
                self._digits.named(offer)
            except AssertionError as error:
                self.doubled.append(f"{offer.position}: {error}")
        super().said(side, message)

    def _one_cipher(self, offer: Offer) -> None:
        """Under the key stream each offer has a cipher symbol of its own."""

    def put_back(self, side: Name, since: int, folder: Path) -> None:
        """Copy an end's folder, go on, kill the end, and begin again with the copy."""
        copy = folder / "copy"
        shutil.copytree(self.folder / side, copy)
        before = self.plant.state.record.session.id
        self.run(lambda target=self.plant.state.link.k + since: self.plant.state.link.k >= target)  # type: ignore[misc]
        self.kill(side)
        shutil.rmtree(self.folder / side)
        copy.rename(self.folder / side)
        self.start(side)
        self.run(lambda target=self.plant.state.link.k + 3: self.plant.state.link.k >= target)  # type: ignore[misc]
        self.counts[f"{side} put back"] += 1
        self.counts["sessions ended"] += self.plant.state.record.session.id != before


def restored(count: int, seed: int) -> Wire:
    """So many restorations of one loop."""
    draw = random.Random(seed)
    with tempfile.TemporaryDirectory() as folder:
        loop = Wire(Path(folder) / "run")
        for _ in range(count):
            target = loop.plant.state.link.k + draw.randint(*BEFORE)
            loop.run(lambda target=target: loop.plant.state.link.k >= target)  # type: ignore[misc]
            loop.put_back(draw.choice(SIDES), draw.choice(SINCE), Path(folder))
        loop.stop()
    return loop


def main(argv: list[str] | None = None) -> int:
    """1 where a digit was named for two steps."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args(argv)
    loop = restored(args.count, args.seed)
    print(dict(loop.counts), *loop.doubled, sep="\n")
    return int(bool(loop.doubled))


if __name__ == "__main__":
    sys.exit(main())
