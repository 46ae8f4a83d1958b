"""``wyner up``: controller, plant and tap on this machine, and a screen to watch them."""

import argparse
from dataclasses import fields
from typing import Final

from runtime import options
from runtime.errors import DONE, FAILED, INTERRUPTED, UsageError
from wyner.cli.results import show
from wyner.cli.session import run_session
from wyner.deployment.one_machine import RunOptions


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Start controller, plant and tap as processes of this machine, watch them on a screen, and "
        "sum up what the plant and each eavesdropper got. In the screen, ? shows the keys; without "
        "a terminal (wyner up | cat) there are lines."
    )
    parser.add_argument(
        "--demo",
        action="store_true",
        help="five short runs, about a minute in all, and a verdict of four lines",
    )
    options.add_arguments(parser, RunOptions)


def run(args: argparse.Namespace) -> int:
    """Start, watch, stop, sum up."""
    if args.demo:
        return _demo(args)
    outcome = run_session(options.picked(RunOptions, vars(args)))
    summary = outcome.figures
    show(outcome, args)
    if outcome.failure is not None:
        raise outcome.failure
    if outcome.interrupted:
        return INTERRUPTED
    if summary["failed"] or (args.until_delivered and not summary["delivered"]):
        return FAILED
    # keys were asked for, and under the scenario's claim there cannot be any
    return FAILED if outcome.scenario.keys is not None and outcome.scenario.keys.refusal() else DONE


TAKEN_BY_DEMO: Final = ("json", "run_dir")
"""Options that the demonstration takes; its runs choose the others."""


def _demo(args: argparse.Namespace) -> int:
    from wyner.cli.demo import run_demo

    given = options.picked(RunOptions, vars(args))
    for one in fields(RunOptions):
        if one.name not in TAKEN_BY_DEMO and getattr(given, one.name) != one.default:
            name = one.name.replace("_", "-")
            raise UsageError(f"--{name}: cannot be given with --demo, whose runs choose it")
    return run_demo(args)
