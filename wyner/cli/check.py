"""``wyner check``: say, one rule after another, whether a run obeyed it."""

import argparse
from pathlib import Path
from textwrap import fill
from typing import Final

from runtime.errors import DONE, FAILED, UsageError
from wyner.cli.results import add_json, show

WIDTH: Final = 78
"""Columns of the help, which has a table and is not set anew."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = fill(
        "Replay the traces and the capture of a run that has ended through the pure "
        "functions of the protocol, and print PASS or FAIL for each rule; SKIP for a rule that "
        "does not apply to the run. Exit code 0 when none fails, 1 when one does, 2 when there is "
        "no run.",
        WIDTH,
    )
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _table()
    parser.add_argument(
        "run_dir", type=Path, metavar="RUN_DIR", help="the run's folder, or a fleet's"
    )
    add_json(parser)


def _table() -> str:
    """Which files are evidence, for people."""
    from wyner.runs.evidence_files import KINDS

    wide = max(len(kind.pattern) for kind in KINDS)
    lines = ["evidence, and what holds it (the seal: that of a run that wyner up has ended):"]
    lines += [f"  {kind.pattern:<{wide}}  {kind.held_by}" for kind in KINDS if kind.evidence]
    lines.append("no evidence:")
    lines += [f"  {kind.pattern:<{wide}}  {kind.held_by}" for kind in KINDS if not kind.evidence]
    return "\n".join([*lines, "  and whatever else lies in the folder"])


def run(args: argparse.Namespace) -> int:
    """Check a run, or every loop of a fleet."""
    from protocol.scenario import ScenarioError
    from wyner.runs.check.checked import check_run

    try:
        found = check_run(args.run_dir)
    except ScenarioError as error:
        raise UsageError(error.problems) from None
    except OSError as error:
        raise UsageError(str(error)) from None
    show(found, args)
    return DONE if found.passed else FAILED
