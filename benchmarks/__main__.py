"""``python -m benchmarks``: how fast wyner is on this machine."""

import argparse
import importlib
import json
import sys
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

from runtime.command import Parser, carry_out, entered
from runtime.errors import DONE, UsageError


class Benchmark(NamedTuple):
    """One benchmark: the module that has ``measure`` and ``render``, and its line in the help."""

    module: str
    text: str


BENCHMARKS: Final = {
    "loop": Benchmark("benchmarks.loop", "the live loop in lock-step"),
    "pace": Benchmark("benchmarks.pace", "the highest rate that misses nothing"),
    "fleet": Benchmark("benchmarks.fleet", "many loops in three processes"),
    "engine": Benchmark("benchmarks.engine", "the engine beside the services' cores"),
    "sets": Benchmark("benchmarks.sets", "the sets beside the polytope package"),
}


def build_parser() -> Parser:
    """The command line."""
    parser = Parser(
        prog="python -m benchmarks",
        description="How fast wyner is on this machine, for developers.",
    )
    lines = "; ".join(f"{name}: {bench.text}" for name, bench in BENCHMARKS.items())
    parser.add_argument("name", choices=(*BENCHMARKS, "all"), metavar="NAME", help=f"{lines}; all")
    parser.add_argument("--loops", type=int, metavar="N", help="fleet: loops (default 50)")
    parser.add_argument("--seconds", type=float, metavar="S", help="fleet: measured (default 10)")
    parser.add_argument("--router", action="store_true", help="fleet: through a router")
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")
    return parser


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    options = _fleet_options(args)
    names = list(BENCHMARKS) if args.name == "all" else [args.name]
    results: dict[str, Any] = {}
    for name in names:
        print(f"{name}: {BENCHMARKS[name].text} ...", file=sys.stderr)
        module = importlib.import_module(BENCHMARKS[name].module)
        measure: Callable[..., dict[str, Any]] = module.measure
        render: Callable[[dict[str, Any]], str] = module.render
        results[name] = measure(progress=_say, **options if name == "fleet" else {})
        if not args.json:
            print(render(results[name]))
    if args.json:
        print(json.dumps(results if args.name == "all" else results[args.name]))
    return DONE


def _say(line: str) -> None:
    """A line of progress, of a round or a rate; standard output is for the result."""
    print(f"  {line}", file=sys.stderr, flush=True)


def _fleet_options(args: argparse.Namespace) -> dict[str, Any]:
    given = {"loops": args.loops, "seconds": args.seconds, "router": args.router or None}
    given = {name: value for name, value in given.items() if value is not None}
    if given and args.name != "fleet":
        raise UsageError(f"--{next(iter(given))}: is for the benchmark fleet")
    if given.get("loops", 1) < 1:
        raise UsageError(f"--loops: got {args.loops}, expected at least 1")
    if not 0 < given.get("seconds", 1.0) <= 86400:
        raise UsageError(f"--seconds: got {args.seconds:g}, expected more than 0, at most 86400")
    return given


def main(argv: Sequence[str]) -> int:
    """Run the command line; returns the exit code."""
    return carry_out(lambda: run(build_parser().parse_args(argv)))


if __name__ == "__main__":
    sys.exit(entered(lambda: main(sys.argv[1:])))
