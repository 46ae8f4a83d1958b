"""``wyner status``: the last status of each service of a run, and warnings."""

import argparse
import socket
from pathlib import Path
from typing import Final

from runtime.errors import DONE, FAILED, Failure, UsageError
from wyner.cli.results import add_json, show

CONNECT_S: Final = 3.0
"""Seconds in which a router must take a connection."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Print the last status of each service of a run, and a warning for each problem. Exit code "
        "0 without a warning, 1 with one."
    )
    parser.add_argument(
        "run_dir", nargs="?", type=Path, metavar="RUN_DIR", help="default: the run that is going on"
    )
    add_json(parser)
    parser.add_argument(
        "--endpoint",
        metavar="ENDPOINT",
        help="only check that a router accepts connections there, such as tcp/router:7447",
    )


def run(args: argparse.Namespace) -> int:
    """Read the statuses and print them."""
    if args.endpoint is not None:
        _connect(args.endpoint)
        print(f"{args.endpoint} takes connections")
        return DONE
    from wyner.deployment.status import status_of

    found = status_of(_run_dir(args.run_dir))
    show(found, args, indent=12)
    return FAILED if found.warnings else DONE


def _run_dir(given: Path | None) -> Path:
    """The folder given, or that of the one run that goes on."""
    from wyner.deployment.running import run_names, running_loops

    if given is not None:
        return given
    loops = running_loops()
    if len(loops) != 1:
        raise UsageError(f"RUN_DIR: runs that go on: {run_names(loops)}; expected one, or a folder")
    return Path(loops[0].run_dir)


def _connect(endpoint: str) -> None:
    """Connect to an endpoint and hang up."""
    address = endpoint.partition("/")[2].partition("#")[0]
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal():
        raise UsageError(f"--endpoint: got {endpoint!r}, expected PROTOCOL/HOST:PORT")
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=CONNECT_S).close()
    except (OSError, OverflowError) as error:
        raise Failure(f"{endpoint}: no answer: {error}") from None
