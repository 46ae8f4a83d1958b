"""``wyner bench``: the benchmarks, which are a program of the checkout and no part of the wheel."""

import argparse
import os
import sys
from pathlib import Path
from typing import Final, NoReturn

from runtime.errors import UsageError

CHECKOUT: Final = Path(__file__).resolve().parents[2]

NO_PREFIX: Final = "\0"
"""No argument of a process begins with it, so that all of them are handed on as they are."""


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the subcommand."""
    parser = subparsers.add_parser("bench", add_help=False, prefix_chars=NO_PREFIX)
    parser.add_argument("arguments", nargs="*")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> NoReturn:
    """Become ``python -m benchmarks``: signals and the exit code are its own."""
    if not (CHECKOUT / "benchmarks").is_dir():
        raise UsageError("bench: the benchmarks come with the source tree; run it from a checkout")
    paths = [str(CHECKOUT), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    sys.stdout.flush()
    command = [sys.executable, "-P", "-m", "benchmarks", *args.arguments]
    os.execve(sys.executable, command, environment)
