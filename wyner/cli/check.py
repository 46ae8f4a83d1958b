"""``wyner check``: say, one rule after another, whether a run obeyed it."""

import argparse
from pathlib import Path

from runtime.errors import DONE, FAILED, UsageError
from wyner.cli.results import add_json, show


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Replay the traces and the capture of a run that has ended through the pure functions of "
        "the protocol, and print PASS or FAIL for each rule; SKIP for a rule that does not apply "
        "to the run. Exit code 0 when none fails, 1 when one does, 2 when there is no run."
    )
    parser.add_argument(
        "run_dir", type=Path, metavar="RUN_DIR", help="the run's folder, or a fleet's"
    )
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Check a run, or every loop of a fleet."""
    from wyner.runs.check.checked import check_run

    try:
        found = check_run(args.run_dir)
    except OSError as error:
        raise UsageError(str(error)) from None
    show(found, args, indent=17)
    return FAILED if found.failed else DONE
