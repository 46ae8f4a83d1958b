"""A seeded sample of the mutants that ``make mutants`` would try, and how many of each room died.

All of them take hours. ``python -m tools.mutants --sample 200`` tries so many of each room, drawn
with a stated seed, and prints the share killed with its 95 % Wilson interval, and the survivors.
"""

import argparse
import random
import re
import subprocess
import sys
from collections.abc import Sequence
from typing import Final

from wyner.scoring.statistics import wilson

ROOMS: Final = ("protocol.schemes", "protocol.link", "wyner.verify")
_LINE: Final = re.compile(r"^\s+(?P<name>\S+__mutmut_\d+): (?P<status>.+)$", re.MULTILINE)
KILLED: Final = ("killed", "timeout", "caught by type check")


def results() -> dict[str, str]:
    """Every mutant with its status, as mutmut tells them."""
    command = [sys.executable, "-m", "mutmut", "results", "--all", "true"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return {m["name"]: m["status"] for m in _LINE.finditer(done.stdout)}


def drawn(names: Sequence[str], count: int, seed: int) -> list[str]:
    """``count`` of each room, or all where there are fewer."""
    chosen = []
    for room in ROOMS:
        mine = sorted(name for name in names if name.startswith(room + "."))
        chosen += random.Random(f"{seed} {room}").sample(mine, min(count, len(mine)))
    return chosen


def table(statuses: dict[str, str], names: Sequence[str]) -> str:
    """The rooms' shares, and the survivors, for those ``names`` that were tried."""
    lines = []
    for room in ROOMS:
        tried = [n for n in names if n.startswith(room + ".") and statuses[n] != "not checked"]
        if not tried:
            continue
        killed = sum(statuses[n] in KILLED for n in tried)
        share = wilson(killed, len(tried)).scaled(100)
        lines.append(
            f"{room}: {killed} of {len(tried)} killed, {share.value:.1f} % "
            f"[{share.low:.1f}, {share.high:.1f}]"
        )
        lines += [f"  {statuses[n]}: {n}" for n in tried if statuses[n] not in KILLED]
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    """Try a sample, or tell of all that was tried."""
    parser = argparse.ArgumentParser(prog="python -m tools.mutants", description=__doc__)
    parser.add_argument("--sample", type=int, metavar="N", help="try N mutants of each room first")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args(argv)
    names = list(results())
    if not names:  # nothing has been generated yet; a room's smallest module is the price
        subprocess.run(
            [sys.executable, "-m", "mutmut", "run", "protocol.schemes.base*"], check=False
        )
        names = list(results())
    if args.sample:
        names = drawn(names, args.sample, args.seed)
        subprocess.run([sys.executable, "-m", "mutmut", "run", *names], check=False)
    print(table(results(), names))
    return 0


if __name__ == "__main__":
    sys.exit(main())
