"""Every interleaving, to a depth: ``python -m tests.campaigns.exhaustive --scheme switched``.

Depth first with states hashed, one depth after the other, so that the first counterexample is a
shortest one. What was finished is appended to a file, from which ``--resume`` goes on.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from protocol.runtime.run_folder import write_atomically
from tests.campaigns.world import SCHEMES, Broken, Doing, World, unpacked
from wyner.studies.grid import code_version


@dataclass
class Exploration:
    """All states within ``depth`` events and ``deaths`` deaths.

    ``going_on`` tries one new state in so many for whether it goes on once all is well.
    """

    scheme: str
    depth: int
    deaths: int
    going_on: int = 50
    step_s: float | None = None
    warm: bool = False
    until: float = float("inf")
    tick: Callable[["Exploration"], None] = lambda _: None
    seen: dict[int, int] = field(default_factory=dict)
    steps: int = 0
    went_on: int = 0
    path: list[Doing] = field(default_factory=list)
    why: str = ""
    complete: bool = True

    def run(self) -> bool:
        """Explore; False when something broke, and ``path`` leads there."""
        world = World(self.scheme, self.step_s)
        if self.warm:
            world.warm_up()
        self.seen[world.key()] = self.depth
        return self._below(world, self.depth)

    def _below(self, world: World, left: int) -> bool:
        if left == 0:
            return True
        if time.monotonic() > self.until:
            self.complete = False
            return True
        packed = world.packed()
        for doing in list(world.choices(self.deaths)):
            after = unpacked(packed)
            self.path.append(doing)
            self.steps += 1
            if self.steps % 2000 == 0:
                self.tick(self)
            try:
                after.do(doing)
            except (Broken, AssertionError) as error:
                self.why = str(error) or type(error).__name__
                return False
            key = after.key()
            known = self.seen.get(key, -1)
            if known < left - 1:
                self.seen[key] = left - 1
                if known < 0 and not self._goes_on(after):
                    return False
                if not self._below(after, left - 1):
                    return False
            self.path.pop()
        return True

    def _goes_on(self, world: World) -> bool:
        if len(self.seen) % self.going_on:
            return True
        self.went_on += 1
        try:
            holds = unpacked(world.packed()).goes_on()
        except (Broken, AssertionError) as error:
            self.why = f"once all was well: {error}"
            return False
        self.why = "" if holds else "no message symbol comes through once all is well"
        return holds


def shortest(
    scheme: str, deepest: int, deaths: int, going_on: int, step_s: float, *, warm: bool
) -> Exploration:
    """Explore depth by depth up to ``deepest``, or until something breaks."""
    for depth in range(1, deepest + 1):
        found = Exploration(scheme, depth, deaths, going_on, step_s, warm)
        if not found.run():
            break
    return found


def main(argv: list[str] | None = None) -> int:
    """Explore for as long as is asked; 1 when something broke."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scheme", choices=SCHEMES, required=True)
    parser.add_argument("--deaths", type=int, default=2)
    parser.add_argument("--deadline", type=float, metavar="S", help="steps end, and are missed")
    parser.add_argument("--warm", action="store_true", help="begin once both ends have met")
    parser.add_argument("--shallowest", type=int, default=1)
    parser.add_argument("--deepest", type=int, default=30)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--results", type=Path, default=Path("campaign-exhaustive.json"))
    parser.add_argument("--resume", action="store_true", help="go on after the last whole depth")
    args = parser.parse_args(argv)
    name = f"{args.scheme}, {args.deaths} deaths"
    name += ", lock-step" if args.deadline is None else f", a deadline of {args.deadline:g} s"
    name += ", once met" if args.warm else ""
    results = json.loads(args.results.read_text()) if args.results.exists() else {}
    first = results.get(name, {}).get("depth", 0) + 1 if args.resume else args.shallowest
    until = time.monotonic() + args.seconds

    def tick(e: Exploration) -> None:
        line = f"\r{name}: depth {e.depth}, {len(e.seen):,} states, {e.steps:,} events"
        print(line, end="", file=sys.stderr, flush=True)

    for depth in range(first, args.deepest + 1):
        e = Exploration(
            args.scheme,
            depth,
            args.deaths,
            step_s=args.deadline,
            warm=args.warm,
            until=until,
            tick=tick,
        )
        holds = e.run()
        told = {
            "version": code_version(),
            "depth": depth,
            "states": len(e.seen),
            "events": e.steps,
            "went_on": e.went_on,
            "complete": e.complete,
        }
        print(f"\r{name}: {told}", file=sys.stderr)
        if not holds:
            print(f"{e.why}, after {len(e.path)} events:")
            for number, doing in enumerate(e.path, start=1):
                print(f"{number:4} {doing}")
            return 1
        results[name if e.complete else f"{name}, cut short"] = told
        write_atomically(args.results, json.dumps(results, indent=1).encode())
        if not e.complete:
            break
    return 0


if __name__ == "__main__":
    sys.exit(main())
