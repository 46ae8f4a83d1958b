"""Live attacked runs in lock-step: ``python -m tests.attacker.live_runs``, and ``--table`` of them.

A run is both services with their journals and traces on disk, on a bus in memory, and
the ghost with her eavesdropper in a process of her own. M is 2, 3 and 4 in turn, or ``--sizes``. Of
each run is kept how many steps the ghost passed after her onset: the steps before the first in
which no disturbance in D_c leads from the plant's own coin to what was reported.

With ``--keyed`` the coin comes from distilled keys, and the controller must alarm in just those
steps. An honest run makes the keys first; each attacked one goes on from a copy of its folder, with
other keys' digits than most, since its onset is drawn. She has heard nothing of that first run: so
she holds no key, as where the claim is true. It can be stopped, and goes on where it was.
"""

import argparse
import csv
import json
import random
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Protocol

from attacker_service.attacker import Attacker
from attacker_service.attacks import named
from attacker_service.relay import Relay
from controller_service.command import designed
from controller_service.laws.base import CandidateLaw
from controller_service.service import ControllerConfig, ControllerService
from plant_service.service import PlantConfig, PlantService
from protocol.agreement import INSIDE
from protocol.scenario import Attack, Scenario
from protocol.statistics import clopper_pearson
from runtime.bus import Bus
from runtime.pace import Pace
from runtime.recording import TraceReader
from runtime.run_folder import CONTROLLER_TRACE, PLANT_TRACE
from runtime.scenario_file import scenario_of
from tests.support.memory_bus import MemoryBus, MemoryHub
from tests.support.traces import Resolved

SIZES = (2, 3, 4)
AFTER = 12
"""Steps of a run from the onset on."""

ONSET = 20
"""Honest steps before an attack: the loop has settled."""

KEYED = {"keys": {"eps_E": 0.3}, "defence": {"coin": "keys"}}
"""The tables of a scenario whose coin is keyed."""

FILLS = 1600
"""Honest steps after which both ends hold keys for the coin."""

SPREAD = 200
"""Steps over which onsets are drawn: some keys' digits."""

RESULTS = Path("build/attacked.jsonl")
DATA = Path(__file__).resolve().parents[2] / "docs" / "data" / "attacked-live.csv"
SHOWN = 6
"""Steps of the table."""


def sized(name: str, size: int, *, keyed: bool) -> Scenario:
    """The scenario with so many candidates, and with a keyed coin if asked."""
    tables = scenario_of(name).model_dump(exclude_unset=True)
    tables["secrecy"]["candidates"] = size
    return Scenario.model_validate(tables | KEYED if keyed else tables)


def run(
    scenario: Scenario,
    law: CandidateLaw,
    steps: int | None,
    folder: Path,
    attack: Attack | None = None,
    pace: str = "fast",
    watch: "Watch | None" = None,
) -> None:
    """Both services up to step ``steps``; they go on from what is in the folder.

    An attack on the bus stands between the two field buses, on a thread. With ``watch`` its
    attacker stands there, and says when the run is over.
    """
    hubs, management, over = [MemoryHub()], MemoryHub(), threading.Event()
    stopping = threading.Event()
    with ExitStack() as stack:
        if attack is not None and named(attack.kind).at == "bus":
            hubs.append(MemoryHub())
            attacker = Attacker(scenario, attack, None)
            asked = attacker if watch is None else watch.attacker(attacker)
            relay = Relay(asked, MemoryBus(hubs[0]), MemoryBus(hubs[1]), "loop")
            stack.enter_context(_beside(lambda: relay.run(over), over))
        if watch is not None:
            watch.listen(MemoryBus(management), stopping)
        config = ControllerConfig(scenario, folder, "loop", law)
        controller = ControllerService(config, MemoryBus(hubs[-1]), MemoryBus(management), over)
        stack.enter_context(_beside(controller.run, over))
        plant = PlantConfig(scenario, folder, "loop", Pace(pace), steps=steps, attack=attack)
        PlantService(plant, MemoryBus(hubs[0]), MemoryBus(management), stopping).run()


class Watch(Protocol):
    """Who lets an attack loose, and ends the run, by what the statuses say."""

    def attacker(self, attacker: Attacker) -> Attacker:
        """What the relay asks."""

    def listen(self, management: Bus, stopping: threading.Event) -> None:
        """Hear the management bus; ``stopping`` ends the run."""


@contextmanager
def _beside(work: Callable[[], object], over: threading.Event) -> Iterator[None]:
    """Have something done on a thread, which ends with this."""
    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def came_to(folder: Path, onset: int, *, keyed: bool) -> dict[str, Any]:
    """Steps that she passed; the failed ones, the controller's alarms, what was wrong."""
    plant = list(Resolved(TraceReader(folder / PLANT_TRACE).lines()))
    controller = list(Resolved(TraceReader(folder / CONTROLLER_TRACE).lines()))
    steps = [e for e in plant if e["event"] == "transition"]
    failed = [e["k"] + 1 for e in steps if e["gauges"][e["coin"]] > INSIDE]
    counted = {e["k"] + 1: e for e in controller if e["event"] == "transition"}
    watched = [k for k, e in counted.items() if e.get("expected", -1) >= 0]
    alarms = [e["k"] + 1 for e in controller if e["event"] == "alarm"]
    wrong = [f"a false alarm at {k}" for k in alarms if k < onset]
    if keyed:
        wrong += [f"no alarm at {k}" for k in failed if k in watched and k not in alarms]
        wrong += [f"alarm at {k}, and nothing failed" for k in alarms if k not in failed]
    watch = keyed and all(k in watched for k in range(onset, onset + AFTER) if k in counted)
    over = [e["attack_failed"] for e in steps if "attack_failed" in e]
    first = min((k for k in failed if k >= onset), default=onset + AFTER)
    true = [e for e in steps if e["k"] + 1 == first and "true_x_next" in e]
    away = [abs(a - b) for e in true for a, b in zip(e["true_x_next"], e["x_next"], strict=True)]
    return {
        "passed": first - onset,
        "watched": watch,
        "away": max(away, default=None),
        "over": over[0] if over else "",
        "wrong": wrong,
    }


class Filled:
    """Folders of honest runs whose journals hold keys, made once each."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._made: dict[int, Path] = {}

    def copied(self, size: int, scenario: Scenario, law: CandidateLaw, to: Path) -> None:
        """Copy the folder of this size."""
        if size not in self._made:
            made = self._made[size] = self._folder / str(size)
            made.mkdir()
            run(scenario, law, FILLS, made)
        shutil.copytree(self._made[size], to, dirs_exist_ok=True)


def attacked(
    scenario: Scenario, law: CandidateLaw, size: int, filled: Filled, draw: random.Random
) -> dict[str, Any]:
    """One attacked run, and what it came to."""
    keyed = scenario.defence.keyed
    onset = ONSET if not keyed else FILLS + ONSET + draw.randrange(SPREAD)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if keyed:
            filled.copied(size, scenario, law, folder)
        run(scenario, law, onset + AFTER, folder, Attack(kind="ghost", onset=onset))
        return {"onset": onset, **came_to(folder, onset, keyed=keyed)}


def table(results: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Undetected shares after n steps, with intervals of 95 % and M^-n.

    Where the coin is keyed only runs count in which every attacked step was watched.
    """
    rows = []
    for scenario, keyed, size in sorted({(r["scenario"], r["keyed"], r["size"]) for r in results}):
        ours = [
            r
            for r in results
            if (r["scenario"], r["keyed"], r["size"]) == (scenario, keyed, size)
            and (r["watched"] or not keyed)
        ]
        for n in range(1, SHOWN + 1):
            left = sum(r["passed"] >= n for r in ours)
            low, high = clopper_pearson(left, len(ours), 0.025)
            rows.append(
                {
                    "scenario": scenario,
                    "coin": "keyed" if keyed else "private",
                    "candidates": size,
                    "steps": n,
                    "runs": len(ours),
                    "undetected": left,
                    "share": left / len(ours),
                    "low": low,
                    "high": high,
                    "theory": size**-n,
                }
            )
    return rows


def merged(
    recorded: Sequence[Mapping[str, Any]], rows: Sequence[Mapping[str, Any]]
) -> list[Mapping[str, Any]]:
    """Rows on record, and new ones in place of those of the same runs that rest on no more runs."""

    def of(row: Mapping[str, Any]) -> tuple[str, str, int]:
        return row["scenario"], row["coin"], int(row["candidates"])

    known = {of(row): int(row["runs"]) for row in recorded}
    newer = {of(row) for row in rows if int(row["runs"]) >= known.get(of(row), 0)}
    kept = [row for row in recorded if of(row) not in newer]
    kept += [row for row in rows if of(row) in newer]
    return sorted(kept, key=lambda row: (row["coin"] == "keyed", *of(row), int(row["steps"])))


def main(argv: Sequence[str] | None = None) -> int:
    """Run what is left, or write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenario", default="packed")
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES, metavar="M")
    parser.add_argument("--keyed", action="store_true", help="the coin comes from keys")
    parser.add_argument("--runs", type=int, default=420)
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--table", action="store_true", help=f"write docs/data/{DATA.name}")
    args = parser.parse_args(argv)
    args.results.parent.mkdir(parents=True, exist_ok=True)
    lines = args.results.read_text().splitlines() if args.results.exists() else []
    results = [json.loads(line) for line in lines]
    if args.table:
        with DATA.open(newline="", encoding="utf-8") as file:
            rows = merged(list(csv.DictReader(file)), table(results))
        with DATA.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
        return 0
    scenarios = {size: sized(args.scenario, size, keyed=args.keyed) for size in args.sizes}
    laws = {size: designed(scenario) for size, scenario in scenarios.items()}
    until = time.monotonic() + args.seconds
    ours = [
        r
        for r in results
        if (r["scenario"], r["keyed"]) == (args.scenario, args.keyed) and r["size"] in args.sizes
    ]
    done, wrong = len(ours), sum(bool(r["wrong"]) for r in ours)
    draw = random.Random()  # of the operating system, as her own
    with args.results.open("a", encoding="utf-8") as file, tempfile.TemporaryDirectory() as name:
        filled = Filled(Path(name))
        while done < args.runs and time.monotonic() < until:
            size = args.sizes[done % len(args.sizes)]
            found = attacked(scenarios[size], laws[size], size, filled, draw)
            if found["over"]:  # a busy machine: she had no time, and the truth passed
                print(f"\nagain: {found['over']}", file=sys.stderr)
                continue
            wrong += bool(found["wrong"])
            line = {"scenario": args.scenario, "keyed": args.keyed, "size": size, **found}
            print(json.dumps(line), file=file, flush=True)
            done += 1
            print(f"\r{done} of {args.runs}, {wrong} wrong", end="", file=sys.stderr, flush=True)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
