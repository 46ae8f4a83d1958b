"""Live attacked runs in lock-step: ``python -m tests.campaigns.attacked``, and ``--table`` of them.

A run is both services with their journals, traces and key stores on disk, on a bus in memory, and
the ghost with her eavesdropper in a process of her own. M is 2, 3 and 4 in turn. Of each run is
kept how many steps the ghost passed after her onset: the steps before the first in which no
disturbance in D_c leads from the plant's own coin to what was reported. Where the coin is keyed the
controller must alarm in just those steps. It can be stopped, and goes on where it was.
"""

import argparse
import csv
import json
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from controller_service.command import designed
from controller_service.laws.base import CandidateLaw
from controller_service.service import ControllerConfig, ControllerService
from plant_service.service import PlantConfig, PlantService
from protocol.agreement import INSIDE
from protocol.scenario import Attack, Scenario
from protocol.statistics import clopper_pearson
from runtime.memory_bus import MemoryBus, MemoryHub
from runtime.pace import Pace
from runtime.recording import TraceReader
from runtime.run_folder import CONTROLLER_TRACE, PLANT_TRACE
from runtime.scenario_file import scenario_of
from wyner.runs.resolve import Resolved

SIZES = (2, 3, 4)
AFTER = 12
"""Steps of a run from the onset on."""

RESULTS = Path("build/attacked.jsonl")
DATA = Path(__file__).resolve().parents[2] / "docs" / "data" / "attacked-live.csv"
SHOWN = 6
"""Steps of the table."""


def sized(scenario: Scenario, size: int) -> Scenario:
    """The scenario with so many candidates."""
    secrecy = scenario.secrecy.model_copy(update={"candidates": size})
    return Scenario.model_validate(
        scenario.model_copy(update={"secrecy": secrecy}).model_dump(exclude_unset=True)
    )


def run(scenario: Scenario, law: CandidateLaw, onset: int, folder: Path) -> None:
    """One run of both services, to its end."""
    field, ops, stopping = MemoryHub(), MemoryHub(), threading.Event()
    attack = Attack(kind="ghost", onset=onset)
    controller = ControllerService(
        ControllerConfig(scenario, folder, "loop", law), MemoryBus(field), MemoryBus(ops), stopping
    )
    thread = threading.Thread(target=controller.run)
    thread.start()
    try:
        config = PlantConfig(
            scenario, folder, "loop", Pace("fast"), steps=onset + AFTER, attack=attack
        )
        PlantService(config, MemoryBus(field), MemoryBus(ops), threading.Event()).run()
    finally:
        stopping.set()
        thread.join(20)


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


def table(results: Sequence[dict[str, Any]], scenario: str) -> list[dict[str, Any]]:
    """Undetected shares after n steps, with intervals of 95 % and M^-n.

    Where the coin is keyed only runs count in which every attacked step was watched.
    """
    rows, keyed = [], scenario_of(scenario).defence.keyed
    for size in SIZES:
        ours = [r for r in results if r["size"] == size and r["scenario"] == scenario]
        if keyed:
            ours = [r for r in ours if r["watched"]]
        for n in range(1, SHOWN + 1):
            left = sum(r["passed"] >= n for r in ours)
            low, high = clopper_pearson(left, len(ours), 0.025)
            rows.append(
                {
                    "scenario": scenario,
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


def main(argv: Sequence[str] | None = None) -> int:
    """Run what is left, or write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenario", default="packed")
    parser.add_argument("--onset", type=int, default=20, help="late enough for keys, if any")
    parser.add_argument("--runs", type=int, default=420)
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--table", action="store_true", help=f"write docs/data/{DATA.name}")
    args = parser.parse_args(argv)
    args.results.parent.mkdir(parents=True, exist_ok=True)
    lines = args.results.read_text().splitlines() if args.results.exists() else []
    results = [json.loads(line) for line in lines]
    if args.table:
        rows = [
            row for name in sorted({r["scenario"] for r in results}) for row in table(results, name)
        ]
        with DATA.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
        return 0
    base = scenario_of(args.scenario)
    scenarios = {size: sized(base, size) for size in SIZES}
    laws = {size: designed(scenario) for size, scenario in scenarios.items()}
    keyed = base.defence.keyed
    until = time.monotonic() + args.seconds
    done = sum(r["scenario"] == args.scenario for r in results)
    wrong = sum(bool(r["wrong"]) for r in results)
    with args.results.open("a", encoding="utf-8") as file:
        while done < args.runs and time.monotonic() < until:
            size = SIZES[done % len(SIZES)]
            with tempfile.TemporaryDirectory() as folder:
                run(scenarios[size], laws[size], args.onset, Path(folder))
                found = came_to(Path(folder), args.onset, keyed=keyed)
            line = {"scenario": args.scenario, "size": size, "onset": args.onset, **found}
            if found["over"]:  # a busy machine: she had no time, and the truth passed
                print(f"\nagain: {found['over']}", file=sys.stderr)
                continue
            wrong += bool(found["wrong"])
            print(json.dumps(line), file=file, flush=True)
            done += 1
            print(f"\r{done} of {args.runs}, {wrong} wrong", end="", file=sys.stderr, flush=True)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
