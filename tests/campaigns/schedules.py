"""Seeded schedules of the whole link: ``python -m tests.campaigns.schedules --count 1000000``.

Each seed draws its own faults: loss, repetition, delay, deaths and lost journals. Both endpoints,
their journals and the shell are those of the services. Goes on where it stopped.
"""

import argparse
import json
import random
import sys
import time
from pathlib import Path

from protocol.runtime.run_folder import write_atomically
from tests.support.small_run import law_of
from wyner.simulate.network import Faults, Simulation
from wyner.simulate.safety import violations
from wyner.studies.grid import code_version

PAYLOADS = (b"", b"x")
STEPS = 40


def faults_of(seed: int) -> tuple[Faults, float | None]:
    """The faults of a seed, and the length of its steps (None for lock-step)."""
    draw = random.Random(seed)
    faults = Faults(
        loss=draw.choice((0.0, 0.05, 0.3)),
        repeat=draw.choice((0.0, 0.1, 0.5)),
        delay_s=draw.choice((0.0, 0.02, 0.2)),
        crash=draw.choice((0.0, 0.02, 0.1)),
        amnesia=draw.choice((0.0, 0.0, 0.3)),
        until_s=8.0,
    )
    return faults, draw.choice((None, 0.1))


def broken(seed: int) -> list[str]:
    """What did not hold under the schedule of a seed."""
    scenario, law = law_of("sustained")
    faults, step_s = faults_of(seed)
    link = Simulation(
        scenario, law, seed=seed, payloads=PAYLOADS, faults=faults, step_s=step_s, run=seed
    )
    history = link.run(steps=STEPS, seconds=20.0)
    lines = list(violations(history, PAYLOADS))
    if link.k < STEPS and not lines:
        lines.append(f"{link.k} of {STEPS} steps although all has been well for 12 s")
    return lines


def main(argv: list[str] | None = None) -> int:
    """Go through the seeds; 1 when one broke something."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--results", type=Path, default=Path("campaign-schedules.json"))
    args = parser.parse_args(argv)
    done = json.loads(args.results.read_text()) if args.results.exists() else {}
    if done.get("version") != code_version():
        done = {"version": code_version(), "schedules": 0, "broken": []}
    until = time.monotonic() + args.seconds
    for seed in range(done["schedules"], args.count):
        if lines := broken(seed):
            done["broken"].append([seed, *lines])
            print(f"seed {seed}: {lines}")
        done["schedules"] = seed + 1
        if seed % 500 == 0 or time.monotonic() > until or seed + 1 == args.count:
            write_atomically(args.results, json.dumps(done).encode())
            print(f"\r{seed + 1:,} schedules", end="", file=sys.stderr, flush=True)
            if time.monotonic() > until:
                break
    return 1 if done["broken"] else 0


if __name__ == "__main__":
    sys.exit(main())
