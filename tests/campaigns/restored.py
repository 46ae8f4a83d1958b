"""Folders put back under a live loop: ``python -m tests.campaigns.restored --count 200``.

Each run is a whole loop of processes that makes keys, seals messages and serves applications;
blocks are signed in every other run. Copies of either end's folder are taken at random instants,
from files in use. Then an end is killed by SIGKILL, with its key server or without, its folder
becomes one of its older copies, and it is started again; sealed messages are on their way before
and after, and copies of both ends are put back in one run, one after the other: once the end before
has said that it learned from the other one what was given.

What must hold is measured on the field bus, by a tap that hears all: no key is in two different
sealed messages, and no two tags are under one pad. The names of the pads are what the ends traced,
in all lives. Nor may an application get a key twice. An end that cannot use what was put back, for
a copy of a file in use may be of two minds, says so in one line; then its folder is what it was
before. A key server under which its store is put back ends, and is started again. Goes on where it
stopped.
"""

import json
import random
import shutil
import sys
import tempfile
import time
from collections import Counter, defaultdict
from contextlib import suppress
from pathlib import Path
from typing import Final

from protocol.messages import Sealed
from protocol.secret.records import Side, StoreError
from runtime.keys.asking import AUDITED
from runtime.keys.store import KeyStore
from runtime.run_folder import CAPTURE
from tests.campaigns.live import LiveLoop, keep_failed, plain_text, wait_for
from tests.campaigns.resumable import Results, options
from tests.campaigns.traffic import Traffic

SIDES: Final[tuple[Side, Side]] = ("controller", "plant")
RESTORATIONS: Final = 10
"""In one run."""

KEYS_S: Final = 120.0
"""How long a loop has to make its first keys; no part of what is tried."""

MET_S: Final = 60.0
"""How long the ends have to meet: before that the other folder is not put back."""

NO_TAG: Final = frozenset({"", "0" * 32})


class PutBack:
    """One run: a loop, copies of its ends' folders, and what it comes to."""

    def __init__(self, seed: int, folder: Path, restorations: int) -> None:
        self.draw = random.Random(seed)
        self.folder, self.restorations = folder, restorations
        self.counts: Counter[str] = Counter()
        self.wrong: list[str] = []
        self.signed = seed % 2 == 0
        text = plain_text(self.draw, 40)
        self.loop = LiveLoop(folder, text.encode(), pace="x40", secret=self.signed)
        self.traffic = Traffic(self.loop, text, self.draw)
        self.copies: dict[Side, list[Path]] = {side: [] for side in SIDES}
        self.refused: set[Path] = set()
        self.traces: list[Path] = []

    def run(self) -> None:
        """Put back, again and again."""
        with self.traffic:
            made = wait_for(lambda: self._keys() > 3, KEYS_S)
            self.counts["runs without a key"] = int(
                not made
            )  # which show nothing, and do not count
            while made and self.counts["restorations"] < self.restorations and not self.wrong:
                for side in SIDES:
                    if len(self.copies[side]) < 2 or self.draw.random() < 0.4:
                        self._copy(side)
                self._send()
                time.sleep(self.draw.choice((0.0, self.draw.uniform(0.0, 0.4))))
                self._put_back(self.draw.choice(SIDES))
                self._send()
                time.sleep(self.draw.uniform(0.5, 2.5))
            time.sleep(2.0)
        for side in SIDES:
            self.traces += (self.loop.run_dir / side).glob("trace*")
        self._judge()

    # --- what happens -----------------------------------------------------------------------------

    def _keys(self) -> int:
        with suppress(StoreError), KeyStore(self._store("controller"), "controller") as store:
            return store.available()
        return 0

    def _store(self, side: Side) -> Path:
        return self.loop.run_dir / side / "keys.sqlite3"

    def _send(self) -> None:
        if self.draw.random() < 0.8 and self._keys() > 1:
            self.traffic.send(sealed=True)

    def _copy(self, side: Side) -> None:
        """As an operator does it: file by file, while they are written."""
        target = self.folder / "copies" / f"{side}-{len(self.copies[side])}"
        _copied(self.loop.run_dir / side, target)
        self.copies[side].append(target)

    def _put_back(self, side: Side) -> None:
        process, server = (self.loop.processes[name] for name in (side, f"kme-{side}"))
        copy = self.draw.choice([c for c in self.copies[side] if c not in self.refused] or [None])
        if copy is None:
            return
        process.kill()
        if self.draw.random() < 0.5:
            server.kill()
            self.counts["key servers killed"] += 1
        here, before = self.loop.run_dir / side, self.folder / "copies" / "before"
        shutil.rmtree(before, ignore_errors=True)
        self._keep_trace(side)
        here.rename(before)
        _copied(copy, here)
        told_before = process.log.stat().st_size
        process.start()
        wait_for(lambda: AUDITED in _log(process.log, told_before) or not process.alive(), MET_S)
        if not process.alive():
            told = self.loop.last_line(side)
            self.counts["refused in a line"] += 1
            if "sqlite3" not in told:
                self.wrong.append(f"{side} ended: {told}")
            self.refused.add(copy)
            shutil.rmtree(here)
            before.rename(here)
            process.start()
        else:
            self.counts["restorations"] += 1
            self.counts[f"of the {side}"] += 1
            met = AUDITED in _log(process.log, told_before)
            self.counts["had not met"] += not met
            if not met:
                self.wrong.append(f"{side}: the other end has not said what was given")
        if not server.alive():
            server.start()

    def _keep_trace(self, side: Side) -> None:
        for trace in (self.loop.run_dir / side).glob("trace*"):
            kept = self.folder / f"kept-{len(self.traces)}.jsonl"
            shutil.copy(trace, kept)
            self.traces.append(kept)

    # --- what must hold ---------------------------------------------------------------------------

    def _judge(self) -> None:
        sealed: dict[str, set[tuple[str, bytes, str]]] = defaultdict(set)
        tags: dict[tuple[str, str, int], set[str]] = defaultdict(set)
        for line in (self.loop.run_dir / CAPTURE).read_bytes().splitlines():
            with suppress(ValueError, KeyError, TypeError):
                event = json.loads(line)
                topic, body = event["topic"], event["message"]
                if topic == Sealed.topic:
                    message = Sealed.model_validate_json(json.dumps(body))
                    for name in message.key_ids:
                        sealed[name].add((message.id, message.cipher, message.tag))
                elif body["tag"] not in NO_TAG:
                    side = "plant" if topic == "measurement" else "controller"
                    tags[side, body["session"], body["block"]].add(body["tag"])
        self.counts["keys on the wire"] = len(sealed)
        self.counts["sealed messages on the wire"] = len({m for ms in sealed.values() for m in ms})
        self.counts["tags on the wire"] = sum(map(len, tags.values()))
        self.wrong += [
            f"key {name} is in {len(messages)} sealed messages"
            for name, messages in sealed.items()
            if len(messages) > 1
        ]
        if self.signed:
            self._judge_pads(tags)
        self.wrong += self.traffic.customer.judged()
        self.counts["keys to applications"] = len(self.traffic.customer.got["alice"])
        self.counts["operators answered"] = sum(o.ended == [0] for o in self.traffic.operators)
        self.counts["operators"] = len(self.traffic.operators)

    def _judge_pads(self, tags: dict[tuple[str, str, int], set[str]]) -> None:
        origins: dict[tuple[str, str, int], set[str]] = defaultdict(set)
        for trace in self.traces:
            for line in trace.read_bytes().splitlines():
                with suppress(ValueError, KeyError, TypeError):
                    event = json.loads(line)
                    if event["event"] == "block" and event["signed"]:
                        session, number = event["session"], event["number"]
                        for side in SIDES:  # a set of pads signs a block at both ends
                            origins[side, session, number].add(event["signed"])
        under: dict[tuple[str, str], set[str]] = defaultdict(set)
        for at, shown in tags.items():
            if not origins[at]:
                self.counts["tags of an unknown pad"] += 1
            for origin in origins[at]:
                under[at[0], origin] |= shown
        self.counts["pads on the wire"] = len(under)
        self.wrong += [
            f"{len(shown)} tags of the {side} are under the pads {origin}"
            for (side, origin), shown in under.items()
            if len(shown) > 1
        ]


def _log(path: Path, since: int) -> str:
    return path.read_bytes()[since:].decode(errors="replace")


def _copied(source: Path, target: Path) -> None:
    """A copy of a folder, of whatever is there when its turn comes."""
    target.mkdir(parents=True)
    for file in sorted(source.iterdir()):
        with suppress(FileNotFoundError):
            if file.is_file():
                shutil.copy2(file, target / file.name)


def one_run(seed: int, folder: Path, restorations: int) -> tuple[Counter[str], list[str]]:
    """Put folders back under one loop; how often, and what was wrong."""
    run = PutBack(seed, folder, restorations)
    run.run()
    return run.counts, run.wrong + [w for w in run.traffic.wrong if "twice" in w or "differs" in w]


def main(argv: list[str] | None = None) -> int:
    """Run after run; 1 when something was wrong."""
    parser = options(__doc__, "campaign-restored.json")
    parser.add_argument("--count", type=int, default=200, help="restorations")
    parser.add_argument("--seed", type=int, help="this run alone, kept in --folder")
    parser.add_argument("--folder", type=Path)
    args = parser.parse_args(argv)
    if args.seed is not None:
        args.folder.mkdir()
        counts, wrong = one_run(args.seed, args.folder, min(args.count, RESTORATIONS))
        print(dict(counts), *wrong, sep="\n")
        return 1 if wrong else 0
    results = Results(args.results, {"runs": 0, "restorations": 0})
    done, until = results.done, time.monotonic() + args.seconds
    while done["restorations"] < args.count and time.monotonic() < until:
        seed = done["runs"]
        with tempfile.TemporaryDirectory() as folder:
            left = min(RESTORATIONS, args.count - done["restorations"])
            counts, wrong = one_run(seed, Path(folder), left)
            if wrong:
                keep_failed(Path(folder), args.results, str(seed))
        done["runs"] += 1
        done["restorations"] += counts["restorations"]
        results.add(f"run {seed}", counts, wrong)
        results.save(f"{done['runs']} runs, {done['restorations']} restorations")
    return results.exit_code


if __name__ == "__main__":
    sys.exit(main())
