"""The ``wyner`` command: finds the subcommand and runs it."""

import argparse
import importlib
import importlib.util
import sys
from collections.abc import Sequence
from importlib.metadata import version
from typing import Final

from runtime.command import Parser, carry_out
from runtime.services import SERVICES

COMMANDS: Final = {
    "up": "run controller, plant and tap on this machine and watch them",
    "demo": "the whole story in three short runs: read, sealed, and the control",
    "dashboard": "watch a running system",
    "send": "hand a running controller a message to deliver",
    "unsealed": "show the sealed messages that a plant has opened",
    "design": "compute and show a scenario's sets, gains and expected rate",
    "capacity": "show how many symbols a scenario's inputs can carry, over alpha",
    "bound": "bits that any tap leaves who watches the machine through noise",
    "fit": "identify a plant, calibrate D_c and certify it with fresh sessions",
    "check": "replay a run's traces and say whether they obey the paper",
    "report": "write a run's page: one file of HTML with figures, scores and clauses",
    "replay": "decode a recorded capture",
    "secrecy": "report what each eavesdropper got, beside what the paper's rule counts",
    "export": "write a capture as MCAP, CSV or Parquet",
    "scenarios": "list the shipped scenarios",
    "new": "write a scenario file of one's own, with comments",
    "sweep": "run a grid of experiments",
    "plot": "draw a sweep's rows: rates, or what an eavesdropper got",
    "figures": "draw the figures from their data",
    "bench": "measure speed beside a reference, in one run",
    "knowledge": "write what a scenario's eavesdropper knows",
    "secret": "make the secret by which both ends sign key blocks",
    "certs": "make certificates for mutual TLS",
    "kme": "hand one side's keys to its application (ETSI GS QKD 014)",
    "rotate": "take a fresh key into use at both ends, again and again",
    "router": "run a Zenoh router, with access control where asked",
    "status": "what a run's services last said, and what contradicts it",
    "health": "say whether a service advances",
}
"""Subcommand, and its line in the help; the module is ``wyner.cli.NAME``. Services bring theirs."""


def commands() -> dict[str, str]:
    """Every subcommand and its line in the help: those here, and each service's own."""
    first, *others = COMMANDS
    services = {n: SERVICES[n].summary for n in SERVICES if SERVICES[n].command}
    return {first: COMMANDS[first], **services, **{n: COMMANDS[n] for n in others}}


def _add_parser(name: str, text: str, subparsers: "argparse._SubParsersAction[Parser]") -> None:
    """Add a subcommand with its options; what is here of a service's goes before its own."""
    here = importlib.util.find_spec(f"wyner.cli.{name}") is not None
    module = importlib.import_module(f"wyner.cli.{name}" if here else SERVICES[name].command)
    if name == "bench":  # it hands its arguments on, and makes a parser that takes any
        module.add_parser(subparsers)
        return
    parser = subparsers.add_parser(name, help=text, description=None if here else text)
    module.add_arguments(parser)
    parser.set_defaults(run=module.run)


def build_parser(name: str | None) -> argparse.ArgumentParser:
    """The whole command's parser, with the options of the subcommand ``name`` only.

    The others appear by name, so that starting one command does not import them all.
    """
    parser = Parser(
        prog="wyner",
        description="Send a secret message inside a control loop, and measure what "
        "an eavesdropper gets.",
    )
    parser.add_argument("--version", action="version", version=f"wyner {version('wyner')}")
    subparsers = parser.add_subparsers(
        dest="command", metavar="COMMAND", required=True, parser_class=Parser
    )
    for command, text in commands().items():
        if command == name:
            _add_parser(command, text, subparsers)
        else:
            subparsers.add_parser(command, help=text)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code and never lets a traceback out."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    name = next((a for a in arguments if not a.startswith("-")), None)
    return carry_out(lambda: build_parser(name).parse_args(arguments))


if __name__ == "__main__":
    sys.exit(main())
