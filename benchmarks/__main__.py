"""``python -m benchmarks``, and from a checkout ``wyner bench``: speed beside a reference."""

import argparse
import importlib
import json
import sys
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

from benchmarks import record
from runtime.command import Parser, carry_out, entered
from runtime.errors import DONE, FAILED, UsageError


class Benchmark(NamedTuple):
    """One benchmark: the module that has ``measure`` and ``render``, and its line in the help."""

    module: str
    text: str


BENCHMARKS: Final = {
    "loop": Benchmark("benchmarks.loop", "the live loop beside bare Zenoh round trips"),
    "keys": Benchmark("benchmarks.keys", "the live loop without and with keys"),
    "pace": Benchmark("benchmarks.pace", "the highest rate that misses nothing"),
    "fleet": Benchmark("benchmarks.fleet", "many loops in three processes"),
    "overload": Benchmark("benchmarks.overload", "too many loops, and what comes after"),
    "engine": Benchmark("benchmarks.engine", "the engine beside the plain loop"),
    "attacked": Benchmark("benchmarks.attacked", "attacked runs together beside one alone"),
    "sets": Benchmark("benchmarks.sets", "the sets beside the polytope package"),
    "text": Benchmark("benchmarks.text", "the strongest tap's cost a step, within its bound"),
    "qp": Benchmark("benchmarks.qp", "one step's programs, by solver"),
}

WATCHES: Final = ("record", "compare")


def build_parser() -> Parser:
    """The command line."""
    parser = Parser(
        prog="wyner bench",
        description="How fast wyner is on this machine, each time beside a reference in the same "
        "run; for developers: whether a change made it slower (record before it, compare after).",
    )
    lines = "; ".join(f"{name}: {bench.text}" for name, bench in BENCHMARKS.items())
    lines += "; all; record: the watched ratios into benchmarks/record.json; compare: with it"
    parser.add_argument("name", choices=(*BENCHMARKS, "all", *WATCHES), metavar="NAME", help=lines)
    parser.add_argument("--of", metavar="NAME,...", help="record, compare: these benchmarks only")
    parser.add_argument("--loops", type=int, metavar="N", help="fleet: loops (default 50)")
    parser.add_argument("--seconds", type=float, metavar="S", help="fleet: measured (default 10)")
    parser.add_argument("--router", action="store_true", help="fleet: through a router")
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")
    return parser


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    names, options = _names(args), _fleet_options(args)
    results: dict[str, Any] = {}
    for name in names:
        print(f"bench {name}: {BENCHMARKS[name].text} ...", file=sys.stderr)
        module = importlib.import_module(BENCHMARKS[name].module)
        measure: Callable[..., dict[str, Any]] = module.measure
        render: Callable[[dict[str, Any]], str] = module.render
        results[name] = measure(progress=_say, **options if name == "fleet" else {})
        if not args.json and args.name not in WATCHES:
            print(render(results[name]))
    if args.name in WATCHES:
        return _watch(args, results)
    if args.json:
        print(json.dumps(results if args.name == "all" else results[args.name]))
    return DONE if all(result.get("held", True) for result in results.values()) else FAILED


def _say(line: str) -> None:
    """A line of progress, of a round or a rate; standard output is for the result."""
    print(f"  {line}", file=sys.stderr, flush=True)


def _names(args: argparse.Namespace) -> list[str]:
    """The benchmarks asked for."""
    if args.name not in WATCHES:
        if args.of is not None:
            raise UsageError("--of: is for bench record and compare")
        return list(BENCHMARKS) if args.name == "all" else [args.name]
    names = list(record.WATCHED) if args.of is None else args.of.split(",")
    for name in names:
        if name not in record.WATCHED:
            raise UsageError(f"--of: got {name!r}, expected some of {', '.join(record.WATCHED)}")
    return names


def _watch(args: argparse.Namespace, results: dict[str, Any]) -> int:
    """Add to the record, or say what fell since."""
    from wyner.sweeps.code import loop_version

    try:
        entries = record.read()
        if args.name == "record":
            entry = record.add(results, loop_version())
            print(json.dumps(entry) if args.json else f"{record.RECORD.name}: {entry['ratios']}")
            return DONE
    except ValueError as error:
        raise UsageError(str(error)) from None
    found = record.falls(results, entries)
    told = {name: {**fall._asdict(), "fell": fall.fell} for name, fall in found.items()}
    print(json.dumps(told) if args.json else record.render(found, entries))
    return FAILED if any(fall.fell for fall in found.values()) else DONE


def _fleet_options(args: argparse.Namespace) -> dict[str, Any]:
    given = {"loops": args.loops, "seconds": args.seconds, "router": args.router or None}
    given = {name: value for name, value in given.items() if value is not None}
    if given and args.name != "fleet":
        raise UsageError(f"--{next(iter(given))}: is for bench fleet")
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
