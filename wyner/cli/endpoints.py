"""Endpoints of the three buses: defaults for one machine, options for several."""

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

from protocol.runtime.process import UsageError
from protocol.topics import DEFAULT_LOOP, check_loop

if TYPE_CHECKING:
    from protocol.runtime.zenoh_bus import Endpoints
    from wyner.deployment.running import RunningLoop

Bus = Literal["field", "ops", "intel"]
BUSES: Final[tuple[Bus, ...]] = ("field", "ops", "intel")

PLANT_FIELD: Final = "tcp/127.0.0.1:7461"
CONTROLLER_FIELD: Final = "tcp/127.0.0.1:7462"
PLANT_OPS: Final = "tcp/127.0.0.1:7463"
CONTROLLER_OPS: Final = "tcp/127.0.0.1:7464"
TAP_INTEL: Final = "tcp/127.0.0.1:7465"

DEFAULTS: Final[dict[str, dict[Bus, tuple[tuple[str, ...], tuple[str, ...]]]]] = {
    "plant": {"field": ((PLANT_FIELD,), ()), "ops": ((PLANT_OPS,), ())},
    "controller": {
        "field": ((CONTROLLER_FIELD,), (PLANT_FIELD,)),
        "ops": ((CONTROLLER_OPS,), (PLANT_OPS,)),
    },
    "tap": {"field": ((), (PLANT_FIELD, CONTROLLER_FIELD)), "intel": ((TAP_INTEL,), ())},
    "dashboard": {"ops": ((), (PLANT_OPS, CONTROLLER_OPS)), "intel": ((), (TAP_INTEL,))},
    "send": {"ops": ((), (CONTROLLER_OPS,))},
}
"""For each service and bus: where it listens, and where it connects to. Peers do not relay, so each
partner is named."""


def add_endpoint_arguments(parser: argparse.ArgumentParser, service: str) -> None:
    """Add ``--loop``, ``--listen``, ``--connect``, ``--client``, ``--tls``, ``--scouting``."""
    buses = ", ".join(DEFAULTS[service])
    group = parser.add_argument_group(
        "endpoints", f"BUS is one of: {buses}; an option replaces that bus's default"
    )
    group.add_argument("--loop", default=DEFAULT_LOOP, metavar="ID", help="id of the control loop")
    for option, what in (("--listen", "listen at"), ("--connect", "connect to")):
        group.add_argument(
            option,
            action="append",
            default=[],
            metavar="BUS=ENDPOINT",
            help=f"{what} an endpoint such as tcp/127.0.0.1:7461 (repeatable)",
        )
    group.add_argument(
        "--client",
        action="append",
        default=[],
        metavar="BUS",
        help="open this bus as a client of the router it connects to",
    )
    group.add_argument(
        "--tls",
        action="append",
        default=[],
        metavar="BUS=FOLDER",
        help="mutual TLS with ca.pem, cert.pem and key.pem of this folder",
    )
    group.add_argument(
        "--scouting", action="store_true", help="let peers find one another by multicast"
    )


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
    if told and args.run_name is None:
        return None
    loop = chosen(args.run_name, CONTROLLER_OPS)
    if loop is not None:
        args.loop = loop.loop
        ends = {"ops": (loop.plant_ops, loop.controller_ops), "intel": (loop.intel,)}
        args.connect = [f"{bus}={end}" for bus in DEFAULTS[service] for end in ends.get(bus, ())]
    return loop


def _split(option: str, values: Iterable[str], allowed: Iterable[str]) -> list[tuple[str, str]]:
    pairs = []
    for value in values:
        bus, _, rest = value.partition("=")
        if bus not in allowed or not rest:
            raise UsageError(
                f"{option}: got {value!r}, expected BUS=VALUE with BUS one of {', '.join(allowed)}"
            )
        pairs.append((bus, rest))
    return pairs


def loop_of(args: argparse.Namespace) -> str:
    """The checked ``--loop``."""
    try:
        return check_loop(args.loop)
    except ValueError as error:
        raise UsageError(f"--{error}") from None


def endpoints_of(args: argparse.Namespace, service: str, bus: Bus) -> "Endpoints":
    """The endpoints of one bus of a service, after the defaults and the options.

    Raises
    ------
    UsageError
        When an option names a bus that the service does not have.
    """
    from protocol.runtime.zenoh_bus import Endpoints, TlsFiles

    defaults = DEFAULTS[service]
    listens = _split("--listen", args.listen, defaults)
    connects = _split("--connect", args.connect, defaults)
    folders = dict(_split("--tls", args.tls, defaults))
    for name in args.client:
        if name not in defaults:
            raise UsageError(f"--client: got {name!r}, expected one of {', '.join(defaults)}")
    listen, connect = defaults[bus]
    if any(name == bus for name, _ in (*listens, *connects)):
        listen = tuple(endpoint for name, endpoint in listens if name == bus)
        connect = tuple(endpoint for name, endpoint in connects if name == bus)
    return Endpoints(
        listen=listen,
        connect=connect,
        client=bus in args.client,
        tls=TlsFiles.in_folder(Path(folders[bus])) if bus in folders else None,
        scouting=args.scouting,
    )
