"""The ``wyner`` command: finds the subcommand and runs it."""

import argparse
import importlib
import importlib.util
import sys
from collections.abc import Sequence
from importlib.metadata import version
from typing import Final

from runtime.command import Parser, carry_out
from runtime.errors import USAGE
from runtime.services import SERVICES

COMMANDS: Final[dict[str, dict[str, str]]] = {
    "run": {
        "up": "start controller, plant and tap here, and watch",
        "controller": "start one service alone",
        "plant": "start one service alone",
        "tap": "start one service alone",
        "dashboard": "watch services that run already",
        "send": "queue a message at a running controller",
    },
    "look": {
        "check": "does a run obey the paper, rule by rule?",
        "score": "what did each eavesdropper get of a run?",
        "report": "a run as a page of HTML, CSV or Parquet",
    },
    "design": {
        "new": "write a scenario file from A and B",
        "design": "compute a scenario's sets, gain and rate",
        "fit": "estimate A, B and D_c from recordings",
        "sweep": "run a grid of simulations",
    },
    "operate": {
        "router": "start a Zenoh router with access control",
        "certs": "write certificates for mutual TLS",
        "status": "what do the services of a run report?",
    },
}
"""Subcommands by group, with their lines in the help; the module is ``wyner.cli.NAME``. Services
bring theirs. Neighbours of one line share it."""


def groups() -> dict[str, dict[str, str]]:
    """Every subcommand and its line in the help, by group; a service's own are run."""
    ours = {name for group in COMMANDS.values() for name in group}
    added = {n: SERVICES[n].summary for n in SERVICES if SERVICES[n].command and n not in ours}
    return {name: group | added if name == "run" else group for name, group in COMMANDS.items()}


def commands() -> dict[str, str]:
    """Every subcommand and its line in the help."""
    return {name: text for group in groups().values() for name, text in group.items()}


def overview() -> str:
    """The help: every command, by group, on one screen of 80 x 24."""
    lines = [
        "usage: wyner COMMAND ...          (wyner COMMAND --help says more; --version)",
        "Send a secret message inside a control loop; measure what an eavesdropper gets.",
        "Exit codes: 0 done; 1 something was found, or it failed; 2 wrong use.",
        "",
    ]
    for group, its in groups().items():
        shared: dict[str, list[str]] = {}
        for name, text in its.items():
            shared.setdefault(text, []).append(name)
        for i, (text, names) in enumerate(shared.items()):
            lines.append(f"{group if i == 0 else '':8}{', '.join(names):24}{text}".rstrip())
    return "\n".join([*lines, ""])


class _Whole(Parser):
    """The command itself: its help is one screen."""

    def format_help(self) -> str:
        """All commands by group."""
        return overview()


def _add_parser(name: str, text: str, subparsers: "argparse._SubParsersAction[Parser]") -> None:
    """Add a subcommand with its options; what is here of a service's goes before its own."""
    here = importlib.util.find_spec(f"wyner.cli.{name}") is not None
    module = importlib.import_module(f"wyner.cli.{name}" if here else SERVICES[name].command)
    parser = subparsers.add_parser(name, description=None if here else text)
    module.add_arguments(parser)
    parser.set_defaults(run=module.run)


def build_parser(name: str | None) -> argparse.ArgumentParser:
    """The whole command's parser, with the options of the subcommand ``name`` only.

    The others appear by name, so that starting one command does not import them all.
    """
    parser = _Whole(prog="wyner")
    parser.add_argument("--version", action="version", version=f"wyner {version('wyner')}")
    subparsers = parser.add_subparsers(
        dest="command", metavar="COMMAND", required=True, parser_class=Parser
    )
    for command, text in commands().items():
        if command == name:
            _add_parser(command, text, subparsers)
        else:
            subparsers.add_parser(command)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code and never lets a traceback out."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    name = next((a for a in arguments if not a.startswith("-")), None)
    if not arguments:
        print(overview(), end="", file=sys.stderr)
        return USAGE

    def command() -> int:
        args = build_parser(name).parse_args(arguments)
        return int(args.run(args))

    return carry_out(command)


if __name__ == "__main__":
    sys.exit(main())
