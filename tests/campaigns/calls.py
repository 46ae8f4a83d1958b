"""SIGKILL at chosen system calls: ``python -m tests.campaigns.calls``. Needs a C compiler.

Every service of a live loop dies before, in the middle of, or after its Nth write, sync, rename,
removal or send, of each kind and on each of its files. It is started again, and dies at the next.
Each run has some of these deaths, in an order drawn from its seed;
:mod:`tests.campaigns.traffic` says what must have come of it. Goes on where it stopped.
"""

import random
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Final, NamedTuple

from tests.campaigns.live import LiveLoop, keep_failed, plain_text, preloaded
from tests.campaigns.resumable import Results, options
from tests.campaigns.traffic import Traffic

BYTES: Final = ("before", "tear", "after")
PLAIN: Final = ("before", "after")
NUMBERS: Final = (1, 2, 3, 5, 8, 20, 100)
A_RUN: Final = 50
REACHED_S: Final = 8.0
"""Seconds after which a death is not waited for any longer."""

HOW: Final = {
    "write": BYTES,
    "pwrite64": BYTES,
    "send": BYTES,
    "writev": PLAIN,
    "fdatasync": PLAIN,
    "fsync": PLAIN,
    "ftruncate64": PLAIN,
    "unlink": PLAIN,
    "rename": PLAIN,
}


def _of_end(side: str) -> tuple[tuple[str, str], ...]:
    disk = ("write", "pwrite64", "fdatasync", "fsync", "ftruncate64", "unlink")
    told = (("write", f"{side}/trace"), ("rename", f"{side}/status"))
    kept = tuple((call, f"{side}/journal") for call in disk)
    return (*kept, *told, ("send", "socket"), ("writev", "socket"))


TARGETS: Final = {
    "plant": _of_end("plant"),
    "controller": _of_end("controller"),
    "tap": (("write", "tap/capture"), ("rename", "tap/"), ("send", "socket")),
}


class Death(NamedTuple):
    """Where a service dies."""

    service: str
    call: str
    file: str
    number: int
    how: str

    @property
    def spec(self) -> str:
        """As hostile.c reads it."""
        return f"{self.call}:{self.file}:{self.number}:{self.how}"


def deaths() -> list[Death]:
    """All that are to be tried, in an order of their own."""
    found = [
        Death(service, call, file, number, how)
        for service, targets in TARGETS.items()
        for call, file in targets
        for how in HOW[call]
        for number in NUMBERS
    ]
    random.Random(0).shuffle(found)
    return found


def one_run(
    seed: int, folder: Path, chosen: list[Death], beyond: dict[str, int]
) -> tuple[Counter[str], list[str]]:
    """Let every chosen death happen, as far as it is reached; what was wrong.

    ``beyond`` has the numbers that were not reached, by target; higher ones are left out.
    """
    draw = random.Random(seed)
    text = plain_text(draw, 200)
    loop = LiveLoop(folder, text.encode(), pace="x20")
    counts: Counter[str] = Counter()
    with Traffic(loop, text, draw) as traffic:
        time.sleep(0.5)
        for number, death in enumerate(chosen):
            target = f"{death.service} {death.call} {death.file}"
            if death.number >= beyond.get(target, death.number + 1):
                continue
            victim = loop.processes[death.service]
            victim.kill()
            victim.start(death.spec)
            reached = victim.wait(REACHED_S)
            counts[target] += reached
            counts["reached" if reached else "not reached"] += 1
            if not reached:
                beyond[target] = death.number
            if reached and victim.ended[-1] >= 0:
                said = loop.last_line(death.service)
                traffic.wrong.append(f"{death.service}: code {victim.ended[-1]}: {said}")
            victim.kill()
            victim.start()
            if number % 10 == 9:
                traffic.send()
        traffic.arrive()
    return counts, traffic.judged(counts)


def main(argv: list[str] | None = None) -> int:
    """Run after run; 1 when something was wrong."""
    parser = options(__doc__, "campaign-calls.json")
    parser.add_argument("--count", type=int, default=len(deaths()))
    args = parser.parse_args(argv)
    preloaded(__spec__.name, sys.argv[1:] if argv is None else argv)
    results = Results(args.results, {"tried": 0, "beyond": {}})
    done, until = results.done, time.monotonic() + args.seconds
    every = deaths()[: args.count]
    while done["tried"] < len(every) and time.monotonic() < until:
        chosen = every[done["tried"] : done["tried"] + A_RUN]
        with tempfile.TemporaryDirectory() as folder:
            counts, wrong = one_run(done["tried"], Path(folder), chosen, done["beyond"])
            if wrong:
                keep_failed(Path(folder), args.results, str(done["tried"]))
        done["tried"] += len(chosen)
        results.add(f"up to {done['tried']}", counts, wrong)
        results.save(f"{done['tried']} of {len(every)}, {done['counts']['reached']} deaths")
    return results.exit_code


if __name__ == "__main__":
    sys.exit(main())
