"""``python -m studies``: what is measured for the documents, their tables and their figures."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from runtime.command import Parser, carry_out
from runtime.errors import DONE, FAILED, Failure, UsageError, needs


def build_parser() -> argparse.ArgumentParser:
    """The program's options."""
    parser = Parser(prog="python -m studies", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    measure = commands.add_parser("measure", help="add to data files what they lack")
    measure.add_argument("name", nargs="+", help="which, such as corners")
    measure.add_argument("--only", default="", metavar="TEXT", help="tasks that contain this")
    commands.add_parser("tables", help="write the tables on their pages")
    draw = commands.add_parser("figures", help="draw figures, all or those named")
    draw.add_argument("name", nargs="*", help="which (default: all)")
    draw.add_argument("--output", type=Path, metavar="D", help="folder (default: docs/figures)")
    measure.add_argument("--jobs", type=int, default=1, metavar="N", help="workers (1)")
    measure.add_argument("--dask", nargs="?", const="", metavar="ADDRESS", help="Dask workers")
    for one in (measure, draw):
        one.add_argument("--data", type=Path, metavar="D", help="folder (default: docs/data)")
    commands.add_parser("stale", help="list files with rows of other code")
    scheme = commands.add_parser("scheme", help="the table of schemes, with one of your own")
    scheme.add_argument("scheme", metavar="FILE.py:NAME")
    scheme.add_argument("--scenario", default="packed", help="what it runs on (packed)")
    scheme.add_argument("--seed", type=int, default=1, help="of its runs (1)")
    return parser


def run(args: argparse.Namespace) -> int:
    """What is asked."""
    from studies import DATA
    from studies.registry import pages, stale

    match args.command:
        case "measure":
            _measure(args)
        case "tables":
            for path, text in pages().items():
                path.write_text(text, encoding="utf-8")
        case "figures":
            _figures(args, args.data or DATA)
        case "stale":
            lines = list(stale())
            print(*lines, f"{len(lines)} files have rows of other code", sep="\n")
            return FAILED if lines else DONE
        case "scheme":
            _scheme(args.scheme, args.scenario, args.seed)
    return DONE


def _measure(args: argparse.Namespace) -> None:
    from runtime.options import at_least
    from studies import DATA
    from studies.registry import studies
    from wyner.sweeps.workers import workers

    known = studies()
    for name in args.name:
        if name not in known:
            raise UsageError(f"name: got {name!r}, expected one of {', '.join(sorted(known))}")
    at_least("--jobs", args.jobs, 1)
    with workers(args.jobs, args.dask) as executor:
        for name in args.name:
            path = (args.data or DATA) / f"{name}.csv"
            known[name].measure(path, executor, args.only)
            print(path)


def _figures(args: argparse.Namespace, data: Path) -> None:
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise UsageError(needs("figures", "matplotlib")) from None
    from studies import FIGURES_FOLDER
    from studies.figures import FIGURES, draw
    from wyner.sweeps.grid import SweepError

    unknown = [name for name in args.name if name not in FIGURES]
    if unknown:
        raise UsageError(f"figures: got {unknown[0]!r}, expected {', '.join(FIGURES)}")
    names = args.name or list(FIGURES)
    try:
        for name in names:
            print(draw(name, data, args.output or FIGURES_FOLDER))
    except SweepError as error:
        raise Failure(str(error)) from None
    except OSError as error:
        raise Failure(f"{error.filename}: cannot be written: {error.strerror}") from None


def _scheme(name: str, scenario: str, seed: int) -> None:
    from protocol.plugins import UnknownError
    from protocol.scenario import ScenarioError
    from studies.schemes import with_own

    try:
        print(with_own(name, scenario, seed))
    except (UnknownError, ScenarioError) as error:
        raise UsageError(f"scheme: {error}") from None


def main(arguments: Sequence[str] | None = None) -> int:
    """Returns the exit code."""
    return carry_out(lambda: run(build_parser().parse_args(arguments)))


if __name__ == "__main__":
    sys.exit(main())
