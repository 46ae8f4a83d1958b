"""Network tables live: ``python -m tests.campaigns.tables --steps 300``.

Each run is ``wyner up`` behind a table of its own, at the plant's own pace or another. A step that
the table takes is missed on any machine, and a step that it leaves may be missed by a machine that
is late. The two are told apart step by step: the campaign fails where a step was made that the
table takes, or where over all runs of a table the share that it takes is not the one computed. It
goes on where it stopped.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from protocol.statistics import share_over_runs
from runtime.run_folder import PLANT_TRACE
from runtime.scenario_file import load_scenario
from runtime.shipped import SCENARIOS
from tests.support.traces import read_trace
from wyner.advice.missed_share import expected_missed_share
from wyner.simulate.missed import missed_steps

BURSTS: Final = "loss = 0.05\nloss_bad = 0.9\nto_bad = 0.05\nto_good = 0.3\n"
JITTER: Final = 'delay = "gamma"\ndelay_s = 0.03\njitter_s = 0.02\n'
MEASURED: Final = 'delay = "measured"\nfile = "delays.txt"\n'
DELAYS: Final = "0.004\n0.012\n0.031\n0.058\n0.012\n0.24\n"
"""A file of measured delays, one of them longer than two steps."""
TABLES: Final = {
    "losses": ("loss = 0.4\n", "loss = 0.4\n"),
    "bursts": ("", BURSTS),
    "jitter": (JITTER, JITTER),
    "late": ("delay_s = 0.05\n", 'delay = "uniform"\ndelay_s = 0.03\njitter_s = 0.03\n'),
    "measured": (MEASURED, MEASURED),
}
"""Each table's two directions, to the controller and to the plant, as in a scenario's file."""

MANY: Final = 400
"""Simulated runs by which the share that a table takes of a run is known."""


def scenario_file(folder: Path, name: str) -> Path:
    """The scenario `sustained` behind a table, in a file beside that of the measured delays."""
    up, down = TABLES[name]
    text = (SCENARIOS / "sustained.toml").read_text()
    text += f"\n[network.to_controller]\n{up}\n[network.to_plant]\n{down}"
    path = folder / f"{name}.toml"
    path.write_text(text)
    (folder / "delays.txt").write_text(DELAYS)
    return path


def live(folder: Path, name: str, seed: int, steps: int, pace: str) -> dict[str, Any]:
    """One run: how many steps the table takes, and how many others were missed.

    Raises
    ------
    RuntimeError
        When the run fails.
    """
    file, run_dir = scenario_file(folder, name), folder / f"{name}-{seed}"
    done = subprocess.run(
        [
            *(sys.executable, "-m", "wyner.cli.main", "up", "--scenario", str(file)),
            *("--steps", str(steps), "--pace", pace, "--seed", str(seed), "--headless"),
            *("--eavesdropper", "nearest-centre", "--run-dir", str(run_dir)),
        ],
        capture_output=True,
        text=True,
        timeout=1200,
        check=False,
    )
    if done.returncode:
        raise RuntimeError(done.stderr)
    events = read_trace(run_dir / PLANT_TRACE).events
    without = {e["k"] for e in events if e["event"] == "missed"}
    made = {e["k"] for e in events if e["event"] == "transition"}
    taken = missed_steps(load_scenario(file), seed=seed, runs=range(1), steps=steps, folder=folder)
    assert taken is not None
    table = {k for k in range(steps) if taken[k, 0]}
    return {
        "table": name,
        "seed": seed,
        "steps": steps,
        "pace": pace,
        "taken": len(table),
        "made": len(made),
        "made_though_taken": len(table & made),
        "late_host": len(without - table),
    }


def judged(folder: Path, name: str, rows: Sequence[dict[str, Any]]) -> tuple[bool, str]:
    """Whether a table's runs are as computed, and the line that says so."""
    scenario = load_scenario(scenario_file(folder, name))
    steps = rows[0]["steps"]
    expected = expected_missed_share(scenario, folder)
    many = missed_steps(scenario, seed=999, runs=range(MANY), steps=steps, folder=folder)
    assert many is not None
    assert expected is not None
    spread = float(many.mean(axis=0).std()) / len(rows) ** 0.5
    found = share_over_runs([(row["taken"] - row["made_though_taken"], steps) for row in rows])
    good = abs(found.value - expected) <= 3 * spread + 1e-9
    good = good and not any(row["made_though_taken"] for row in rows)
    late = sum(row["late_host"] for row in rows)
    line = (
        f"{name}: {len(rows)} runs of {steps} steps at {rows[0]['pace']}, missed by the table "
        f"{100 * found.value:.2f} %, computed {100 * expected:.2f} (3 deviations "
        f"{300 * spread:.2f}); missed besides, by a late machine: {late}"
    )
    return good, line


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is left to run, and judge; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.campaigns.tables")
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--pace", default="realtime")
    parser.add_argument("--folder", type=Path, default=Path("campaign-tables"))
    options = parser.parse_args(arguments)
    options.folder.mkdir(parents=True, exist_ok=True)
    results = options.folder / "results.json"
    rows = json.loads(results.read_text()) if results.exists() else []
    done = {(row["table"], row["seed"], row["steps"], row["pace"]) for row in rows}
    for seed in range(1, options.seeds + 1):
        for name in TABLES:
            if (name, seed, options.steps, options.pace) in done:
                continue
            rows.append(live(options.folder, name, seed, options.steps, options.pace))
            results.write_text(json.dumps(rows, indent=1) + "\n")
            print(rows[-1], file=sys.stderr, flush=True)
    wrong = 0
    for name in TABLES:
        mine = [
            row
            for row in rows
            if (row["table"], row["steps"], row["pace"]) == (name, options.steps, options.pace)
        ]
        good, line = judged(options.folder, name, mine)
        wrong += not good
        print(line if good else f"{line}: NOT AS COMPUTED")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
