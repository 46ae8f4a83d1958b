"""SIGKILL and SIGSTOP of live services: ``python -m tests.campaigns.kills --kills 1000``.

Each run is a `wyner up` whose services are killed at random instants, started again by it, and
sometimes frozen for a while. At the end the message must be there once and `wyner check` must pass.
"""

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

from protocol.runtime.run_folder import write_atomically
from wyner.studies.grid import code_version
from wyner.verify import check
from wyner.verify.evidence import read_evidence

MESSAGE = "x" * 12
KILLS_A_RUN = 24
SERVICES = ("controller", "plant", "tap")


def children(pid: int) -> dict[str, int]:
    """The services that a `wyner up` runs, by name."""
    found: dict[str, int] = {}
    with suppress(OSError, ValueError):
        listed = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        for child in map(int, listed):
            line = Path(f"/proc/{child}/cmdline").read_bytes().decode(errors="replace")
            found |= {name: child for name in SERVICES if f"{name}_service" in line}
    return found


def one_run(seed: int, folder: Path, kills: int, pace: str = "x20") -> tuple[int, int, list[str]]:
    """Kill and freeze; how many were killed, how many frozen, and what was wrong."""
    draw = random.Random(seed)
    run_dir = folder / f"run-{seed}"
    command = [sys.executable, "-m", "wyner", "up", "--pace", pace, "--until-delivered", "--json"]
    message = folder / "message"
    message.write_text(MESSAGE)
    with (folder / "out").open("wb") as out:
        process = subprocess.Popen(
            [*command, "--message-file", str(message), "--run-dir", str(run_dir)],
            stdout=out,
            stderr=subprocess.DEVNULL,
        )
        killed = frozen = 0
        until = time.monotonic() + 240
        while process.poll() is None and time.monotonic() < until:
            time.sleep(draw.uniform(0.05, 1.0))
            there = children(process.pid)
            if not there or killed >= kills or not (run_dir / "plant" / "status.json").exists():
                continue
            pid = there[draw.choice(sorted(there))]
            with suppress(ProcessLookupError):
                if draw.random() < 0.1:
                    os.kill(pid, signal.SIGSTOP)
                    time.sleep(draw.uniform(0.1, 6.0))
                    os.kill(pid, signal.SIGCONT)
                    frozen += 1
                else:
                    os.kill(pid, signal.SIGKILL)
                    killed += 1
        if process.poll() is None:
            process.terminate()
        process.wait()
    wrong = []
    try:
        summary = json.loads((folder / "out").read_bytes())
        if not summary["delivered"] or summary["recovered"] != MESSAGE:
            wrong.append(f"delivered {summary['delivered']}, recovered {summary['recovered']!r}")
    except (ValueError, KeyError):
        wrong.append(f"exit code {process.returncode}, no summary")
    findings = check(read_evidence(run_dir))
    wrong += [f"{f.clause.name}: {f.tally.first}" for f in findings if f.result == "FAIL"]
    return killed, frozen, wrong


def main(argv: list[str] | None = None) -> int:
    """Run after run; 1 when something was wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--results", type=Path, default=Path("campaign-kills.json"))
    args = parser.parse_args(argv)
    done = json.loads(args.results.read_text()) if args.results.exists() else {}
    if done.get("version") != code_version():
        done = {"version": code_version(), "runs": 0, "killed": 0, "frozen": 0, "wrong": []}
    until = time.monotonic() + args.seconds
    while done["killed"] < args.kills and time.monotonic() < until:
        seed = done["runs"]
        with tempfile.TemporaryDirectory() as folder:
            killed, frozen, wrong = one_run(seed, Path(folder), KILLS_A_RUN)
        done["runs"] += 1
        done["killed"] += killed
        done["frozen"] += frozen
        if wrong:
            done["wrong"].append([seed, *wrong])
            print(f"run {seed}: {wrong}")
        write_atomically(args.results, json.dumps(done, indent=1).encode())
        print(f"\r{done['runs']} runs, {done['killed']} kills", end="", file=sys.stderr, flush=True)
    return 1 if done["wrong"] else 0


if __name__ == "__main__":
    sys.exit(main())
