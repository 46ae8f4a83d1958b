"""SIGKILL and SIGSTOP of live services: ``python -m tests.campaigns.kills --kills 1000``.

Each run is a whole loop of processes: controller, plant, tap, two key servers, and in every other
run a router. Any of them is killed at random instants and started again, or frozen for up to six
seconds, while others are killed. Messages are handed over and keys fetched meanwhile. At the end
every message must be there once, no key may have been given out twice, and `wyner check` must pass.
With ``--jumps`` the wall clock of all of them is set by hours again and again, both ways (needs
a C compiler): nothing may depend on it.
"""

import argparse
import base64
import json
import os
import random
import signal
import sys
import tempfile
import threading
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from protocol.runtime.run_folder import PLANT_TRACE, write_atomically
from protocol.runtime.trace import TraceReader
from protocol.secret.records import StoreError
from tests.campaigns.live import (
    LiveLoop,
    Process,
    all_done,
    keep_failed,
    plain_text,
    preloaded,
    wait_for,
)
from wyner.studies.grid import code_version
from wyner.verify import check
from wyner.verify.evidence import read_evidence

KILLS_A_RUN: Final = 60
FROZEN_S: Final = 6.0
AT_LAST_S: Final = 120.0
"""Seconds that a loop has to deliver what is queued, once all is well."""

SERVICES: Final = ("controller", "plant", "tap", "router", "kme-controller", "kme-plant")
LARGEST_JUMP_S: Final = 48 * 3600
PACES: Final = ("fast", "x100", "x20")


class Customer(threading.Thread):
    """Two applications that fetch keys whenever the servers are there, and note what they got."""

    def __init__(self, loop: LiveLoop) -> None:
        super().__init__(daemon=True)
        self.sites = loop.sites
        self.over = threading.Event()
        self.got: dict[str, list[tuple[str, str]]] = {"alice": [], "bob": []}
        self.wrong: list[str] = []

    def run(self) -> None:
        """Fetch until told that it is over."""
        while not self.over.wait(0.05):
            for key_id, key in self._ask("controller", "alice", "bob/enc_keys"):
                self.got["alice"].append((key_id, key))
                for same in self._ask("plant", "bob", f"alice/dec_keys?key_ID={key_id}"):
                    self.got["bob"].append(same)
                    if same != (key_id, key):
                        self.wrong.append(f"key {key_id} differs")

    def _ask(self, side: str, name: str, path: str) -> list[tuple[str, str]]:
        assert self.sites is not None
        with suppress(OSError, ValueError, AssertionError, KeyError):
            code, told = self.sites.ask(side, name, f"/api/v1/keys/{path}")
            if code == 200:
                return [(k["key_ID"], k["key"]) for k in told["keys"]]
        return []

    def judged(self) -> list[str]:
        """What was wrong with the keys."""
        for name, got in self.got.items():
            for what, place in (("id", 0), ("key", 1)):
                seen = Counter(one[place] for one in got)
                self.wrong += [f"{name} got {what} {x} twice" for x, n in seen.items() if n > 1]
        return self.wrong


class Reaper:
    """Kills and freezes services at instants of its choice."""

    def __init__(self, loop: LiveLoop, draw: random.Random) -> None:
        self.loop, self.draw = loop, draw
        self.clock = os.environ.get("WYNER_CLOCK")
        self.counts: Counter[str] = Counter()
        self._thaw: dict[str, float] = {}
        self._back: dict[str, float] = {}

    def strike(self) -> None:
        """One more blow, and whatever is due of the earlier ones."""
        draw, now = self.draw, time.monotonic()
        if self.clock is not None and draw.random() < 0.3:
            off_s = draw.randint(-LARGEST_JUMP_S, LARGEST_JUMP_S)
            with Path(self.clock).open("r+b") as clock:
                clock.write(off_s.to_bytes(8, "little", signed=True))
            self.counts["clock jumps"] += 1
        name = draw.choice(sorted(self.loop.processes))
        process = self.loop.processes[name]
        if process.alive():
            frozen = name in self._thaw
            if draw.random() < 0.85:
                process.kill()
                self.counts[name] += 1
                self.counts["killed while frozen"] += frozen
                self.counts["killed while another is frozen"] += bool(self._thaw) and not frozen
                self._thaw.pop(name, None)
                self._back[name] = now + draw.choice((0.0, draw.uniform(0.0, 0.5)))
            elif not frozen:
                process.signal(signal.SIGSTOP)
                self.counts["frozen"] += 1
                self._thaw[name] = now + draw.uniform(0.05, FROZEN_S)
        self.mend()

    def mend(self, *, all_of_it: bool = False) -> list[str]:
        """Start and thaw what is due; who ended by itself."""
        now = float("inf") if all_of_it else time.monotonic()
        wrong = []
        for name, process in self.loop.processes.items():
            if name in self._thaw and self._thaw[name] <= now:
                process.signal(signal.SIGCONT)
                del self._thaw[name]
            if not process.alive() and self._back.get(name, 0.0) <= now:
                if process.ended and process.ended[-1] >= 0:
                    said = self.loop.last_line(name)
                    wrong.append(f"{name}: ended by itself, code {process.ended[-1]}: {said}")
                process.start()
        return wrong


def one_run(seed: int, folder: Path, kills: int) -> tuple[Counter[str], list[str]]:
    """Kill and freeze; how often, and what was wrong."""
    draw = random.Random(seed)
    text = plain_text(draw, 200)
    loop = LiveLoop(folder, text.encode(), pace=draw.choice(PACES), router=seed % 2 == 1)
    reaper, customer = Reaper(loop, draw), Customer(loop)
    expected, operators = [text], list[Process]()
    wrong: list[str] = []
    counts = reaper.counts
    loop.start()
    customer.start()
    try:
        time.sleep(draw.uniform(0.5, 1.5))
        while sum(counts[name] for name in loop.processes) < kills and not wrong:
            reaper.strike()
            wrong += reaper.mend()
            if draw.random() < 0.05 and len(operators) < 20:
                expected.append(plain_text(draw, 12))
                operators.append(loop.send(f"message-{len(operators)}", expected[-1]))
            time.sleep(draw.choice((0.0, draw.uniform(0.0, 0.5))))
        reaper.mend(all_of_it=True)
        if not wait_for(lambda: all_done(operators), AT_LAST_S):
            wrong.append("an operator has no answer")
        well = loop.mark()
        if not wait_for(lambda: loop.delivered(well) == len(expected), AT_LAST_S):
            wrong.append(f"{loop.delivered(well)} messages arrive although all is well")
        time.sleep(0.5)
    finally:
        customer.over.set()
        customer.join(30)
        wrong += loop.stop()
        for operator in operators:
            operator.kill()
    wrong += customer.judged()
    counts["messages"], counts["keys"] = len(expected), len(customer.got["alice"])
    wrong += judged(loop.run_dir, expected, counts)
    return counts, wrong


def judged(run_dir: Path, expected: list[str], counts: Counter[str]) -> list[str]:
    """What was wrong with a run that is over: its messages, and what its check says."""
    try:
        trace = TraceReader(run_dir / PLANT_TRACE)
        events = [e for e in trace if e["event"] in ("recovered", "session")]
        evidence = read_evidence(run_dir)
        findings = check(evidence)
    except (OSError, StoreError, ValueError) as error:
        return [f"the run cannot be read: {error}"]
    got = [base64.b64decode(e["payload"]).decode() for e in events if e["event"] == "recovered"]
    counts["sessions"] = len({e["session"] for e in events if e["event"] == "session"})
    counts["transitions"] = (
        0 if evidence.plant is None else sum(evidence.plant.transitions.values())
    )
    seen = Counter(got)
    wrong = [
        f"{text[:20]!r} was recovered {seen[text]} times" for text in expected if seen[text] != 1
    ]
    wrong += [f"{text[:20]!r} was never sent" for text in seen if text not in expected]
    return wrong + [f"{f.clause.name}: {f.tally.first}" for f in findings if f.result == "FAIL"]


def main(argv: list[str] | None = None) -> int:
    """Run after run; 1 when something was wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--seed", type=int, help="this run alone, kept in --folder")
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--jumps", action="store_true", help="set the wall clock again and again")
    parser.add_argument("--results", type=Path, help="default: campaign-kills.json")
    args = parser.parse_args(argv)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    name = "campaign-jumps.json" if args.jumps else "campaign-kills.json"
    args.results = args.results or Path(name)
    if args.jumps:
        clock = Path(tempfile.mkdtemp()) / "clock"
        clock.write_bytes(bytes(8))
        preloaded(__spec__.name, sys.argv[1:] if argv is None else argv, WYNER_CLOCK=str(clock))
    if args.seed is not None:
        args.folder.mkdir()
        counts, wrong = one_run(args.seed, args.folder, KILLS_A_RUN)
        print(dict(counts), *wrong, sep="\n")
        return 1 if wrong else 0
    done: dict[str, Any] = json.loads(args.results.read_text()) if args.results.exists() else {}
    if done.get("version") != code_version():
        done = {"version": code_version(), "runs": 0, "killed": 0, "counts": {}, "wrong": []}
    until = time.monotonic() + args.seconds
    while done["killed"] < args.kills and time.monotonic() < until:
        seed = done["runs"]
        with tempfile.TemporaryDirectory() as folder:
            counts, wrong = one_run(seed, Path(folder), KILLS_A_RUN)
            if wrong:
                keep_failed(Path(folder), args.results, str(seed))
        done["runs"] += 1
        done["killed"] += sum(counts[name] for name in counts if name in SERVICES)
        done["counts"] = dict(Counter(done["counts"]) + counts)
        if wrong:
            done["wrong"].append([seed, *wrong])
            print(f"run {seed}: {wrong}")
        write_atomically(args.results, json.dumps(done, indent=1).encode())
        print(f"\r{done['runs']} runs, {done['killed']} kills", end="", file=sys.stderr, flush=True)
    return 1 if done["wrong"] else 0


if __name__ == "__main__":
    sys.exit(main())
