"""The ``wyner`` command: finds the subcommand, runs it, turns errors into one line and a code."""

import argparse
import importlib
import importlib.util
import os
import sys
from collections.abc import Sequence
from importlib.metadata import version
from typing import Final

from protocol.runtime.process import FAILED, INTERRUPTED, USAGE, Failure, UsageError

COMMANDS: Final = {
    "up": "run controller, plant and tap on this machine and watch them",
    "controller": "run the controller service",
    "plant": "run the plant service with its simulation",
    "tap": "run the tap service with its eavesdroppers",
    "dashboard": "watch a running system",
    "send": "hand a running controller a message to deliver",
    "design": "compute and show a scenario's sets, gains and expected rate",
    "capacity": "show how many symbols a scenario's inputs can carry, over alpha",
    "fit": "identify a plant, calibrate D_c and certify it with fresh sessions",
    "check": "replay a run's traces and say whether they obey the paper",
    "report": "write a run's page: one file of HTML with figures, scores and clauses",
    "replay": "decode a recorded capture",
    "secrecy": "report what each eavesdropper got, beside what the scheme claims",
    "export": "write a capture as MCAP, CSV or Parquet",
    "sweep": "run a grid of experiments",
    "figures": "draw the figures from their data",
    "bench": "measure speed beside a reference, in one run",
    "knowledge": "write what a scenario's eavesdropper knows",
    "certs": "make certificates for mutual TLS",
    "router": "run a Zenoh router, with access control where asked",
    "health": "say whether a service advances",
}
"""Subcommand, and its line in the help; the module is ``wyner.cli.NAME``."""


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line and exit code 2."""

    def error(self, message: str) -> None:  # type: ignore[override]
        """Raise instead of printing the whole usage."""
        raise UsageError(f"{message} (see {self.prog} --help)")


def _available() -> dict[str, str]:
    found = importlib.util.find_spec
    return {n: text for n, text in COMMANDS.items() if found(f"wyner.cli.{n}") is not None}


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
    for command, text in _available().items():
        if command == name:
            importlib.import_module(f"wyner.cli.{command}").add_parser(subparsers)
        else:
            subparsers.add_parser(command, help=text)
    return parser


def _flush_or_drop_output() -> None:
    """Write what is left, or else the interpreter tries again at its end, and complains."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _in_a_line(error: Exception) -> str:
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, OSError) and error.strerror is not None:
        return error.strerror
    return " ".join(f"unexpected {type(error).__name__}: {error}".split())


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code and never lets a traceback out.

    Set ``WYNER_TRACEBACK=1`` to see where an unexpected error came from.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    name = next((a for a in arguments if not a.startswith("-")), None)
    try:
        args = build_parser(name).parse_args(arguments)
        code = int(args.run(args))
        sys.stdout.flush()  # here, where a full disk or a reader that went away is still told
        return code
    except UsageError as error:
        for line in error.lines:
            print(f"wyner: {line}", file=sys.stderr)
        return USAGE
    except Failure as error:
        print(f"wyner: {error}", file=sys.stderr)
        return FAILED
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:
        _flush_or_drop_output()
        return FAILED
    except Exception as error:
        if os.environ.get("WYNER_TRACEBACK"):
            raise
        _flush_or_drop_output()
        print(f"wyner: {_in_a_line(error)}", file=sys.stderr)
        return FAILED


if __name__ == "__main__":
    sys.exit(main())
