"""Journals spoiled between two lives: ``python -m tests.campaigns.spoiled --count 20000``.

Each seed runs a loop, kills an end, and then deletes, truncates, flips, empties, or restores
from an older copy what its journal consists of. The end must either say in one line that it
cannot use its journal, and begin anew once that is removed; or go on. In both cases no cipher
symbol may meet a second key, every message that arrives is one that was sent, and the last one
arrives. What may arrive twice is what a controller was handed again. Where both journals are put
back to one moment neither end can tell: the session goes on from there under new keys, messages
come again, and the check must see it. Goes on where it stopped.
"""

import random
import shutil
import sys
from collections import Counter
from pathlib import Path
from typing import Final

from protocol.secret.records import Side
from runtime.errors import Failure, UsageError
from tests.campaigns.resumable import Results, options, seeds
from tests.support.recorded_loop import RecordedLoop
from tests.support.two_ends import SIDES
from wyner.runs.check import check
from wyner.runs.check.evidence import read_evidence

KINDS: Final = (
    "flipped",
    "truncated",
    "deleted",
    "emptied",
    "restored",
    "one restored",
    "malformed",
    "both restored",
)
SCENARIOS: Final = ("sustained", "keys")
LAST: Final = b"last"

FORGOTTEN: Final = {"messages"}
"""Checks that see that a controller does not know what it was handed after the copy was made."""


def files_of(loop: RecordedLoop, side: Side) -> list[Path]:
    """What the journal of an end consists of."""
    return sorted((loop.folder / side).glob("journal*"))


def put_back(loop: RecordedLoop, side: Side, copy: Path) -> None:
    """An end's whole journal as it was."""
    for one in files_of(loop, side):
        one.unlink()
    for one in (copy / side).glob("journal*"):
        shutil.copy(one, loop.folder / side)


def damaged(whole: bytes, kind: str, draw: random.Random) -> tuple[bytes, int]:
    """What is left of a file that is ``flipped``, ``truncated``, ``emptied`` or ``malformed``.

    And from which place on; any other kind leaves it as it is.
    """
    data = bytearray(whole)
    place = draw.randrange(len(data))
    if kind == "flipped":
        data[place] ^= 1 << draw.randrange(8)
    elif kind == "truncated":
        del data[place:]
    elif kind == "emptied":
        data.clear()
    elif kind == "malformed":
        end = min(len(data), place + draw.randrange(1, 2000))
        data[place:end] = draw.randbytes(end - place)
    return bytes(data), place


def spoil(loop: RecordedLoop, side: Side, kind: str, copy: Path, draw: random.Random) -> str:
    """Do it, and say what was done."""
    files = [f for f in files_of(loop, side) if f.read_bytes().strip(b"\0")]
    file = draw.choice(files)
    whole = file.read_bytes().rstrip(b"\0")  # zeros are written ahead, and mean nothing
    data, place = damaged(whole, kind, draw)
    if kind == "deleted":
        for one in files if draw.random() < 0.5 else [file]:
            one.unlink()
    elif kind == "restored":
        put_back(loop, side, copy)
    elif kind == "one restored":
        if (copy / side / file.name).exists():
            shutil.copy(copy / side / file.name, file)
    else:
        file.write_bytes(data)
    return f"{side}: {file.name} {kind} at {place} of {len(whole)}"


class Spoiled:
    """One seed's run."""

    def __init__(self, seed: int, folder: Path) -> None:
        self.draw = random.Random(seed)
        self.counts: Counter[str] = Counter()
        self.wrong: list[str] = []
        self.side: Side = self.draw.choice(SIDES)
        self.kind = self.draw.choice(KINDS)
        self.sent = [b"first", b"second", LAST]
        self.loop = RecordedLoop(folder / "run", self.sent[0], self.draw.choice(SCENARIOS))
        self.copy = folder / "copy"

    def run(self) -> None:
        """Run, spoil, go on, judge."""
        loop, draw, side = self.loop, self.draw, self.side
        loop.advance(draw.randrange(1, 120))
        for one in SIDES:
            (self.copy / one).mkdir(parents=True)
            for file in files_of(loop, one):
                shutil.copy(file, self.copy / one)
        loop.queue("second", self.sent[1])
        loop.advance(draw.randrange(1, 120))
        if self.kind == "both restored":
            for one in SIDES:
                loop.kill(one)
            for one in SIDES:
                put_back(loop, one, self.copy)
                loop.start(one)
            self._rewound()
            self.done = "both restored"
        else:
            loop.kill(side)
            self.done = spoil(loop, side, self.kind, self.copy, draw)
            self._start()
        self._last()
        loop.stop()
        self._judge()

    def _rewound(self) -> None:
        """The next transition's symbol is the one decided before; all later ones are new."""
        record = self.loop.controller.record
        for session, j in list(self.loop.ciphers):
            if session == record.session and j > record.transitions:
                del self.loop.ciphers[session, j]

    def _start(self) -> None:
        try:
            self.loop.start(self.side)
        except (Failure, UsageError) as error:
            self._refused(error)

    def _refused(self, error: Failure | UsageError) -> None:
        """The journal cannot be used: it is removed, as the line says."""
        lines = error.lines if isinstance(error, UsageError) else [str(error)]
        if len(lines) != 1 or "\n" in lines[0] or "journal" not in lines[0]:
            self.wrong.append(f"said {lines}")
        self.counts["refused"] += 1
        for file in files_of(self.loop, self.side):
            file.unlink()
        self.loop.start(self.side)

    def _last(self) -> None:
        loop = self.loop
        loop.queue("last", LAST)
        for _ in range(2):
            try:
                loop.run(lambda: LAST in loop.received[-1:])
            except (Failure, UsageError) as error:
                loop.kill(self.side)
                self._refused(error)
                loop.queue("last", LAST)
            else:
                return

    def _judge(self) -> None:
        got = Counter(self.loop.recovered)
        back = self.kind == "both restored"
        again = self.side == "controller" or back
        for payload, times in got.items():
            if payload not in self.sent:
                self.wrong.append(f"{payload!r} was never sent")
            if times > 1 and not again:
                self.wrong.append(f"{payload!r} was recovered {times} times")
        results = {r.check.name: r for r in check(read_evidence(self.loop.folder))}
        for name, result in results.items():
            if result.result == "FAIL":
                self.counts[f"check: {name}"] += 1
                if not back and (name not in FORGOTTEN or self.side == "plant"):
                    self.wrong.append(f"{name}: {result.counter.first}")
        if back and results["wire"].result != "FAIL":
            self.wrong.append("the check does not see that both ends went back")


def one_run(seed: int, folder: Path) -> tuple[Counter[str], list[str]]:
    """Spoil a journal; what came of it, and what was wrong."""
    run = Spoiled(seed, folder)
    try:
        run.run()
    except Exception as error:
        run.wrong.append(f"{type(error).__name__}: {error}")
    run.counts[run.kind] += 1
    if run.wrong:
        run.wrong.insert(0, run.done)
    return run.counts, run.wrong


def main(argv: list[str] | None = None) -> int:
    """Seed after seed; 1 when something was wrong."""
    parser = options(__doc__, "campaign-spoiled.json")
    parser.add_argument("--count", type=int, default=20_000)
    args = parser.parse_args(argv)
    return seeds(one_run, Results(args.results, {"runs": 0}), args.count, args.seconds)


if __name__ == "__main__":
    sys.exit(main())
