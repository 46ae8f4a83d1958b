"""Key stores spoiled between two lives: ``python -m tests.campaigns.spoiled_stores``.

Each seed runs a loop that makes keys, has two applications fetch some, kills an end, and deletes,
truncates, flips, empties, or puts back from an older copy what its key store consists of. The end
must say in one line that it cannot use its store, and go on with a new one once that is removed;
or go on. Nobody is given a key twice, and no two keys that were given under one id differ. Where a
store is put back together with the count beside it, its end cannot tell; the other end can, and
refuses. Goes on where it stopped.
"""

import random
import shutil
import sys
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Final

from protocol.secret.records import Side, StoreError, TooFewKeys, UnknownKeys
from runtime.errors import UsageError
from runtime.keys.store import KeyStore
from tests.campaigns.resumable import Results, options, seeds
from tests.campaigns.spoiled import damaged
from tests.support.giving import deliver, deliver_named
from tests.support.recorded_loop import RecordedLoop
from tests.support.two_ends import SIDES

KINDS: Final = (
    "flipped",
    "flipped",
    "truncated",
    "deleted",
    "emptied",
    "malformed",
    "restored",
    "one restored",
    "all restored",
)
MOST_AT_ONCE: Final = 40
TWICE: Final = "were given twice"


class SpoiledStore:
    """One seed's run."""

    def __init__(self, seed: int, folder: Path) -> None:
        self.draw = random.Random(seed)
        self.counts: Counter[str] = Counter()
        self.wrong: list[str] = []
        self.side: Side = self.draw.choice(SIDES)
        self.kind = self.draw.choice(KINDS)
        self.loop = RecordedLoop(folder / "run", b"", "keys")
        self.copy = folder / "copy"
        self.copy.mkdir()
        self.given: dict[str, list[tuple[str, bytes]]] = {side: [] for side in SIDES}

    def run(self) -> None:
        """Run, spoil, go on, judge."""
        self.loop.advance(self.draw.randrange(20, 400))
        self._fetch()
        for file in self._files():
            shutil.copy(file, self.copy)
        self.loop.advance(self.draw.randrange(1, 200))
        self._fetch()
        if self.draw.random() < 0.7:
            self.loop.advance(self.draw.randrange(1, 200))
        self.loop.kill(self.side)
        done = self._spoil()
        self._start()
        for _ in range(3):
            self._fetch()
            self.loop.advance(self.draw.randrange(1, 200))
        self._fetch()
        self.loop.stop()
        self._judge()
        self.wrong = [f"{done}: {text}" for text in self.wrong]

    def _files(self) -> list[Path]:
        return sorted((self.loop.folder / self.side).glob("keys*"))

    # --- applications -----------------------------------------------------------------------------

    def _fetch(self) -> None:
        """A key server of each side gives some of its own half, and the other side finds them."""
        for side, other in (SIDES, SIDES[::-1]):
            try:
                with (
                    KeyStore(self._store(side), side) as mine,
                    KeyStore(self._store(other), other) as theirs,
                ):
                    wanted = min(mine.available(), self.draw.randrange(MOST_AT_ONCE))
                    keys = deliver(mine, wanted, partner=theirs)
            except (StoreError, TooFewKeys) as error:
                self._told(error)
                continue
            self.given[side] += keys
            for name, _ in keys:
                try:
                    with (
                        KeyStore(self._store(side), side) as mine,
                        KeyStore(self._store(other), other) as theirs,
                    ):
                        self.given[other] += deliver_named(theirs, [name], partner=mine)
                except UnknownKeys:
                    self.counts["not at the other end"] += 1
                except StoreError as error:
                    self._told(error)

    def _store(self, side: Side) -> Path:
        return self.loop.folder / side / "keys.sqlite3"

    def _told(self, error: Exception) -> None:
        if isinstance(error, StoreError):
            self.counts["refused to give"] += 1
            if "\n" in str(error) or "keys.sqlite3" not in str(error):
                self.wrong.append(f"said {error}")

    # --- the damage -------------------------------------------------------------------------------

    def _spoil(self) -> str:
        files = self._files()
        store, draw = self._store(self.side), self.draw
        file = draw.choice([f for f in files if f.stat().st_size])
        if self.kind == "deleted":
            for one in files if draw.random() < 0.5 else [file]:
                one.unlink()
        elif self.kind in ("restored", "one restored", "all restored"):
            back = {"restored": [store], "one restored": [file], "all restored": files}[self.kind]
            for one in back:
                shutil.copy(self.copy / one.name, one)
        else:
            data, place = damaged(file.read_bytes(), self.kind, draw)
            file.write_bytes(data)
            return f"{self.side}: {file.name} {self.kind} at {place}"
        return f"{self.side}: {self.kind}"

    def _start(self) -> None:
        try:
            self.loop.start(self.side)
        except (UsageError, StoreError) as error:
            lines = error.lines if isinstance(error, UsageError) else [str(error)]
            if len(lines) != 1 or "\n" in lines[0] or "keys.sqlite3" not in lines[0]:
                self.wrong.append(f"said {lines}")
            self.counts["refused"] += 1
            self.counts[f"refused: {self.kind}"] += 1
            with suppress(KeyError):
                self.loop.kill(self.side)
            for file in self._files():
                file.unlink()
            self.loop.start(self.side)

    # --- what must hold ---------------------------------------------------------------------------

    def _judge(self) -> None:
        self.counts["keys"] += sum(map(len, self.given.values()))
        keys: dict[str, bytes] = {}
        for side, given in self.given.items():
            for what, place in (("ids", 0), ("keys", 1)):
                twice = [x for x, n in Counter(one[place] for one in given).items() if n > 1]
                if twice:
                    text = f"{len(twice)} {what} {TWICE} by the {side}"
                    self.counts[f"{self.kind}: {TWICE}"] += 1
                    self.wrong.append(text)
            for name, key in given:
                if keys.setdefault(name, key) != key:
                    self.wrong.append(f"key {name} differs")


def one_run(seed: int, folder: Path) -> tuple[Counter[str], list[str]]:
    """Spoil a key store; what came of it, and what was wrong."""
    run = SpoiledStore(seed, folder)
    try:
        run.run()
    except Exception as error:
        run.wrong.append(f"{run.side}, {run.kind}: {type(error).__name__}: {error}")
    run.counts[run.kind] += 1
    return run.counts, run.wrong


def main(argv: list[str] | None = None) -> int:
    """Seed after seed; 1 when something was wrong."""
    parser = options(__doc__, "campaign-spoiled-stores.json")
    parser.add_argument("--count", type=int, default=5_000)
    args = parser.parse_args(argv)
    results = Results(args.results, {"runs": 0})
    return seeds(one_run, results, args.count, args.seconds)


if __name__ == "__main__":
    sys.exit(main())
