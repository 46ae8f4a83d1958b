"""``python -m studies NAME``: measure a data file of docs/data anew."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from runtime.command import Parser, carry_out
from runtime.errors import DONE, UsageError


def build_parser() -> argparse.ArgumentParser:
    """The program's options."""
    parser = Parser(prog="python -m studies", description="Measure data files of docs/data anew.")
    parser.add_argument("name", nargs="+", metavar="NAME", help="which, such as corners")
    parser.add_argument("--data", type=Path, metavar="D", help="folder (default: docs/data)")
    return parser


def run(args: argparse.Namespace) -> int:
    """Measure each."""
    from studies import DATA
    from studies.measurements import MEASUREMENTS

    unknown = [name for name in args.name if name not in MEASUREMENTS]
    if unknown:
        known = ", ".join(sorted(MEASUREMENTS))
        raise UsageError(f"name: got {unknown[0]!r}, expected one of {known}")
    folder = args.data or DATA
    folder.mkdir(parents=True, exist_ok=True)
    for name in args.name:
        MEASUREMENTS[name].measure(folder / f"{name}.csv")
        print(folder / f"{name}.csv")
    return DONE


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure; returns the exit code."""
    return carry_out(lambda: run(build_parser().parse_args(arguments)))


if __name__ == "__main__":
    sys.exit(main())
