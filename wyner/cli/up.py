"""``wyner up``: controller, plant and tap on this machine, and a screen to watch them."""

import argparse
import json
from typing import Final

from runtime.errors import DONE, FAILED, INTERRUPTED, UsageError
from runtime.options import add_message_arguments
from wyner.cli.session import run_session
from wyner.deployment.one_machine import RunOptions


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Start controller, plant and tap as processes of this machine, watch them on a screen, and "
        "sum up what the plant and each eavesdropper got. In the screen, ? shows the keys."
    )
    parser.add_argument(
        "--demo",
        action="store_true",
        help="five short runs, a minute in all, and four lines that say what came of them",
    )
    parser.add_argument("--scenario", default="sustained", metavar="S", help="file or shipped name")
    add_message_arguments(parser)
    parser.add_argument(
        "--pace", default="realtime", metavar="P", help="realtime, xN, or fast (lock-step)"
    )
    parser.add_argument("--steps", type=int, metavar="N", help="end at step N")
    parser.add_argument(
        "--until-delivered",
        action="store_true",
        help="end when the plant has the message, and each that was sent meanwhile",
    )
    parser.add_argument(
        "--eavesdropper",
        metavar="NAME[,NAME...]",
        help="who listens besides those of the scenario, by name or as path/to/file.py:Name",
    )
    parser.add_argument(
        "--story", action="store_true", help="pause at what matters, with a caption each time"
    )
    parser.add_argument("--headless", action="store_true", help="lines instead of a screen")
    parser.add_argument("--json", action="store_true", help="end with one JSON object on stdout")
    parser.add_argument(
        "--attack",
        metavar="KIND@STEP",
        help="attack the plant from a step on, such as ghost@200, or path/to/file.py:Name@200",
    )
    parser.add_argument("--run-dir", metavar="D", help="default: a new folder below runs/")
    parser.add_argument("--seed", type=int, metavar="N", help="for experiments: predictable draws")


def run(args: argparse.Namespace) -> int:
    """Start, watch, stop, sum up."""
    if args.demo:
        return _demo(args)
    from wyner.runs.score.summary import render

    outcome = run_session(
        RunOptions(
            scenario=args.scenario,
            message=args.message,
            message_file=args.message_file,
            eavesdropper=args.eavesdropper,
            run_dir=args.run_dir,
            pace=args.pace,
            steps=args.steps,
            seed=args.seed,
            attack=args.attack,
            until_delivered=args.until_delivered,
            headless=args.headless,
            json=args.json,
            story=args.story,
        )
    )
    summary = outcome.summary
    print(json.dumps(summary) if args.json else render(summary))
    if outcome.failure is not None:
        raise outcome.failure
    if outcome.interrupted:
        return INTERRUPTED
    if summary["failed"] or (args.until_delivered and not summary["delivered"]):
        return FAILED
    # keys were asked for, and under the scenario's claim there cannot be any
    return FAILED if outcome.scenario.keys is not None and outcome.scenario.keys.refusal() else DONE


TAKEN_BY_DEMO: Final = ("demo", "headless", "json", "run_dir", "command", "run")
"""Options that the demonstration takes; its runs choose the others."""


def _demo(args: argparse.Namespace) -> int:
    from wyner.cli.demo import run_demo

    plain = argparse.ArgumentParser()
    add_arguments(plain)
    for name, default in vars(plain.parse_args([])).items():
        if name not in TAKEN_BY_DEMO and getattr(args, name) != default:
            option = name.replace("_", "-")
            raise UsageError(f"--{option}: cannot be given with --demo, whose runs choose it")
    return run_demo(args)
