"""Ctrl-C again and again: what the services end with, by hand, under ``wyner up``, in containers.

    python -m tests.campaigns.interrupts [--runs 20] [--double] [--containers]

By hand the three services stand in one process group, as a shell's job does, and the group gets the
signal, as from a terminal. Of ``wyner up`` the group gets it, and each service's recording must
have its end mark: it ended by itself. With ``--double`` a second signal follows within half a
second; a service may then end with 130, and still prints no traceback.
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
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Final

from runtime.recording import parts_of
from runtime.run_folder import CAPTURE, CONTROLLER_TRACE, PLANT_TRACE

SEED: Final = 1
WYNER: Final = [sys.executable, "-m", "wyner"]
BY_HAND: Final = ("tap", "plant", "controller")
START_S, END_S = 40.0, 40.0


def main() -> int:
    """Interrupt so often, and count what came of it; exit code 1 where one run was not clean."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--double", action="store_true")
    parser.add_argument("--containers", action="store_true")
    args = parser.parse_args()
    rng, wrong = random.Random(SEED), 0
    kinds = {"containers": containers} if args.containers else {"by hand": by_hand, "up": up}
    for name, kind in kinds.items():
        ends: Counter[str] = Counter()
        took = []
        for number in range(args.runs):
            again = rng.uniform(0.0, 0.5) if args.double else None
            with tempfile.TemporaryDirectory() as folder:
                began, end, clean = kind(Path(folder), rng.uniform(0.0, 2.0), again)
            took.append(time.monotonic() - began)
            ends[end] += 1
            wrong += not clean
            print(f"{name} {number + 1}: {end}{'' if clean else '  <- wrong'}", file=sys.stderr)
        counts = ", ".join(f"{count} x {end}" for end, count in ends.items())
        middle, longest = sorted(took)[len(took) // 2], max(took)
        print(f"{name}: {counts}; {middle:.1f} s in the middle, {longest:.1f} s at most")
    print(f"{wrong} not clean")
    return bool(wrong)


def by_hand(folder: Path, wait_s: float, again_s: float | None) -> tuple[float, str, bool]:
    """Three services, one process group."""
    processes: list[subprocess.Popen[bytes]] = []
    for name in BY_HAND:
        options = [name, "--scenario", "sustained", "--run-dir", str(folder)]
        options += ["--pace", "x10"] if name == "plant" else []
        with (folder / f"{name}.log").open("wb") as log:
            group = processes[0].pid if processes else 0
            started = subprocess.Popen(
                [*WYNER, *options], stdout=log, stderr=log, process_group=group
            )
        processes.append(started)
    try:
        running(folder)
        time.sleep(wait_s)
        began = interrupt(processes[0].pid, again_s)
        codes = [process.wait(END_S) for process in processes]
    finally:
        for process in processes:
            process.kill()
    quiet = not any(b"Traceback" in (folder / f"{n}.log").read_bytes() for n in BY_HAND)
    # one that has nothing left to give back is ended by the signal itself, 130 to a shell
    allowed = {0} if again_s is None else {0, 130, -signal.SIGINT}
    told = " ".join(map(str, codes)) + ("" if quiet else ", a traceback")
    if not quiet:
        for name in BY_HAND:
            print((folder / f"{name}.log").read_text(), file=sys.stderr)
    return began, told, quiet and set(codes) <= allowed


def up(folder: Path, wait_s: float, again_s: float | None) -> tuple[float, str, bool]:
    """``wyner up``, in a process group of its own."""
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(
            [*WYNER, "up", "--pace", "x10", "--headless", "--run-dir", str(folder / "run")],
            stdout=log,
            stderr=log,
            process_group=0,
        )
    try:
        running(folder / "run")
        time.sleep(wait_s)
        began = interrupt(process.pid, again_s)
        code = process.wait(END_S)
    finally:
        process.kill()
    quiet = not any(b"Traceback" in p.read_bytes() for p in folder.rglob("log"))
    ended = [ends(folder / "run" / path) for path in (PLANT_TRACE, CONTROLLER_TRACE, CAPTURE)]
    whole = all(ended) or again_s is not None
    told = f"{code}, {sum(ended)} of 3 recordings ended" + ("" if quiet else ", a traceback")
    return began, told, quiet and whole and code == 130


def containers(folder: Path, wait_s: float, again_s: float | None) -> tuple[float, str, bool]:
    """``docker compose up`` on a terminal."""
    from tests.compose.composition import Composition, advancing
    from tests.compose.terminal import Terminal

    system = Composition("wyner-interrupts", "direct")
    system.image = os.environ.get("WYNER_IMAGE", system.image)
    system.environment["WYNER_IMAGE"] = system.image
    try:
        with Terminal(system.command("up", "--no-build"), system.environment) as terminal:
            until = time.monotonic() + START_S
            while len(system.compose("ps", "--quiet").stdout.split()) < len(BY_HAND):
                if time.monotonic() > until:
                    raise TimeoutError(terminal.output)
                time.sleep(0.2)
            advancing(system)
            time.sleep(wait_s)
            began = time.monotonic()
            terminal.press("\x03")
            if again_s is not None:
                time.sleep(again_s)
                terminal.press("\x03")
            terminal.wait(END_S)
        codes = [system.inspect(s)["State"]["ExitCode"] for s in BY_HAND]
        # a second Ctrl-C makes Compose kill what has not ended yet
        allowed = {0} if again_s is None else {0, 130, 137}
        return began, " ".join(map(str, codes)), set(codes) <= allowed
    finally:
        system.down()


def running(folder: Path) -> None:
    """Wait until the plant makes transitions."""
    until = time.monotonic() + START_S
    while time.monotonic() < until:
        try:
            told = json.loads((folder / "plant" / "status.json").read_bytes())
            if told["transitions"] > 0:
                return
        except (OSError, ValueError):
            pass
        time.sleep(0.05)
    raise TimeoutError(f"{folder}: nothing runs after {START_S:g} s")


def interrupt(group: int, again_s: float | None) -> float:
    """What a terminal does at Ctrl-C; when it was."""
    began = time.monotonic()
    os.killpg(group, signal.SIGINT)
    if again_s is not None:
        time.sleep(again_s)
        with suppress(ProcessLookupError):
            os.killpg(group, signal.SIGINT)
    return began


def ends(path: Path) -> bool:
    """Whether a recording has its end mark."""
    parts = parts_of(path)
    return bool(parts) and b'"event":"end"' in parts[-1].read_bytes().rstrip().rpartition(b"\n")[2]


if __name__ == "__main__":
    sys.exit(main())
