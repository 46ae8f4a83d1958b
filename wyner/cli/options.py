"""Options of those who join a loop that runs already."""

import argparse
from typing import TYPE_CHECKING

from protocol.runtime.errors import UsageError
from protocol.runtime.services import CONTROLLER_OPS, SERVICES
from protocol.topics import DEFAULT_LOOP

if TYPE_CHECKING:
    from wyner.deployment.running import RunningLoop


def add_run_argument(parser: argparse.ArgumentParser) -> None:
    """Add ``--run``, for those who join a loop that runs already."""
    parser.add_argument(
        "--run",
        dest="run_name",
        metavar="NAME",
        help="the run of `wyner up` to join, where several go on: its folder's name",
    )


def joined(args: argparse.Namespace, service: str) -> "RunningLoop | None":
    """The loop on this machine that is meant where no option says where to connect.

    Its endpoints take the place of the defaults in ``args``.

    Raises
    ------
    UsageError
        When several run and none was named, or the one named does not run.
    """
    from wyner.deployment.running import chosen

    told = args.connect or args.listen or args.client or args.scouting
    if (told or args.loop != DEFAULT_LOOP) and args.run_name is None:
        return None
    loop = chosen(args.run_name, CONTROLLER_OPS)
    if loop is not None:
        args.loop = loop.loop
        ends = {"ops": (loop.plant_ops, loop.controller_ops), "intel": (loop.intel,)}
        args.connect = [
            f"{bus}={end}" for bus in SERVICES[service].ends for end in ends.get(bus, ())
        ]
    return loop


def host_port(option: str, text: str) -> tuple[str, int]:
    """A host and a port as an option names them.

    Raises
    ------
    UsageError
    """
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise UsageError(f"{option}: got {text!r}, expected HOST:PORT")
    return host.strip("[]"), int(port)
