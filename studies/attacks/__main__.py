"""``python -m studies.attacks``: attacks beside defences, or a defence of your own."""

import argparse
import multiprocessing
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from protocol.plugins import UnknownError
from runtime.command import Parser, carry_out
from runtime.errors import DONE, UsageError


def build_parser() -> argparse.ArgumentParser:
    """The program's options."""
    parser = Parser(
        prog="python -m studies.attacks",
        description="Add to docs/data/attacks.csv the rows that it lacks, and write the table of "
        "docs/attacks.md; a run that is stopped goes on where it was.",
    )
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes (default: 1)")
    parser.add_argument(
        "--defence",
        metavar="FILE.py:NAME",
        help="try this defence against every attack instead, and print the shares unseen",
    )
    parser.add_argument(
        "--output", metavar="FILE", help="file of the rows (default: that of docs/data)"
    )
    return parser


def run(args: argparse.Namespace) -> int:
    """Measure."""
    from studies.attacks import study, tables

    if args.jobs < 1:
        raise UsageError(f"--jobs: got {args.jobs}, expected at least 1")
    if args.defence is not None:
        try:
            print(tables.own(args.defence))
        except UnknownError as error:
            raise UsageError(f"--defence: {error}") from None
        return DONE
    context = multiprocessing.get_context("spawn")

    def measured(todo: list[Any]) -> Iterable[dict[str, object]]:
        if args.jobs == 1:
            yield from map(study.measure, todo)
            return
        with context.Pool(args.jobs) as pool:
            yield from pool.imap(study.measure, todo)

    study.add_rows(Path(args.output) if args.output else study.FILE, measured)
    if args.output is None:
        tables.write()
    return DONE


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit code."""
    return carry_out(lambda: run(build_parser().parse_args(arguments)))


if __name__ == "__main__":
    sys.exit(main())
