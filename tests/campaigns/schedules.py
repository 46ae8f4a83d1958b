"""Seeded schedules of the whole link: ``python -m tests.campaigns.schedules --count 1000000``.

Each seed draws its own faults: loss, repetition, delay, deaths and lost journals; one in eight
makes keys too. Both endpoints, their journals and the shell are those of the services. Goes on
where it stopped.
"""

import argparse
import gc
import json
import random
import sys
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, Final

from controller_service.laws.base import CandidateLaw
from protocol.files import write_atomically
from protocol.messages import Measurement, Message, Offer
from protocol.scenario import Scenario
from protocol.scenario.keys import Keys
from protocol.secret.store import KeyStore
from tests.support.copies import Copies
from tests.support.safety import violations
from tests.support.small_run import law_of
from wyner.simulate.faults import Faults
from wyner.simulate.network import Side, Simulation
from wyner.studies.grid import code_version

EACH: Final = 5000
PAYLOADS: Final = (b"", b"x")
STEPS: Final = (6, 12, 24, 48)
"""Steps of a schedule; an eighth of them have the last two."""

SMALL_BLOCKS: Final = Keys(eps_E=0.99, eps_sec=1e-3)
"""Blocks of 2, 4, 8 ... transitions, so that some are confirmed within a schedule."""


@cache
def loop(*, keyed: bool) -> tuple[Scenario, CandidateLaw]:
    """The paper's loop, with keys or without."""
    scenario, law = law_of("sustained")
    return (scenario.model_copy(update={"keys": SMALL_BLOCKS}) if keyed else scenario), law


def faults_of(seed: int) -> tuple[Faults, float | None, int, bool]:
    """The faults of a seed, the length of its steps (None for lock-step), how many, and keys."""
    draw = random.Random(seed)
    faults = Faults(
        loss=draw.choice((0.0, 0.05, 0.3)),
        repeat=draw.choice((0.0, 0.1, 0.5)),
        delay_s=draw.choice((0.0, 0.02, 0.2)),
        crash=draw.choice((0.0, 0.02, 0.1)),
        amnesia=draw.choice((0.0, 0.0, 0.3)),
        until_s=8.0,
    )
    (steps,) = draw.choices(STEPS, (6, 8, 1, 1))
    return faults, draw.choice((None, 0.1)), steps, seed % 8 == 0


class Watched(Simulation):
    """A simulation whose copies are looked at as they leave."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self._copies = Copies()
        super().__init__(*args, **kwargs)

    def send(self, to: Side, kind: type[Message], payload: bytes) -> None:
        """Look at a message of the loop, and send it."""
        if kind in (Measurement, Offer):
            self._copies.left(kind.model_validate_json(payload))
        super().send(to, kind, payload)


def broken(seed: int) -> tuple[int, list[str]]:
    """Keys that both ends have confirmed under the schedule of a seed, and what did not hold."""
    faults, step_s, steps, keyed = faults_of(seed)
    scenario, law = loop(keyed=keyed)
    make = Watched if keyed else Simulation
    try:
        link = make(
            scenario, law, seed=seed, payloads=PAYLOADS, faults=faults, step_s=step_s, run=seed
        )
        history = link.run(steps=steps, seconds=20.0)
    except AssertionError as error:
        return 0, [f"{type(error).__name__}: {error}"]
    lines = list(violations(history, PAYLOADS))
    if link.k < steps and not lines:
        lines.append(f"{link.k} of {steps} steps although all has been well for 12 s")
    if not keyed:
        return 0, lines
    mine, theirs = (link.stores[side] for side in ("controller", "plant"))
    lines += differing(mine, theirs)
    shared = {name for name, state in theirs.ids() if state == "confirmed"}
    return sum(name in shared for name, state in mine.ids() if state == "confirmed"), lines


def differing(mine: KeyStore, theirs: KeyStore) -> Iterator[str]:
    """Keys under one id that are not the same, and keys that one end alone holds for good."""
    for one, other in ((mine, theirs), (theirs, mine)):
        keys = other.compare()
        for (name, state), key in zip(one.ids(), one.compare().values(), strict=True):
            if name in keys and keys[name] != key:
                yield f"key {name}: the two ends hold different ones"
            if state == "confirmed" and name not in keys:
                yield f"key {name}: confirmed at the {one.side}, and not there at the other end"
            if state == "dropped":
                yield f"key {name}: dropped at the {one.side}: the ends hold different blocks"


def main(argv: list[str] | None = None) -> int:
    """Go through the seeds; 1 when one broke something."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--results", type=Path, default=Path("campaign-schedules.json"))
    args = parser.parse_args(argv)
    done = json.loads(args.results.read_text()) if args.results.exists() else {}
    done = {"schedules": 0, "keys": 0, "broken": [], "versions": {}, **done}
    version = code_version()
    done["versions"].setdefault(version, [done["schedules"], 0])
    began, until = time.monotonic(), time.monotonic() + args.seconds
    first = done["schedules"]
    loop(keyed=True)
    gc.freeze()  # what is loaded stays: searching it for garbage took an eighth of the time
    for seed in range(first, args.count):
        keys, lines = broken(seed)
        done["keys"] += keys
        if lines:
            done["broken"].append([seed, *lines])
            print(f"seed {seed}: {lines}")
        done["schedules"] = done["versions"][version][1] = seed + 1
        over = time.monotonic() > until or seed + 1 == args.count
        if over or seed % EACH == 0:
            write_atomically(args.results, json.dumps(done).encode())
            rate = (seed + 1 - first) / (time.monotonic() - began)
            told = f"{seed + 1:,} schedules, {done['keys']:,} keys, {rate:.0f} a second"
            print(told, file=sys.stderr, flush=True)
        if over:
            break
    return 1 if done["broken"] else 0


if __name__ == "__main__":
    sys.exit(main())
