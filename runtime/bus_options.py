"""Options of the buses: where they listen and connect, whose loops they carry, who counts them."""

import argparse
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from protocol.topics import DEFAULT_LOOP, check_loop
from runtime.collection import freeze_startup
from runtime.errors import UsageError
from runtime.logs import logger
from runtime.options import add_bounds_arguments, add_check_argument, add_fleet_arguments
from runtime.services import SERVICES, bus_names
from runtime.signals import stop_on_signals

if TYPE_CHECKING:
    from runtime.addresses import Addresses
    from runtime.bus import Bus
    from runtime.fleet import Fleet


@dataclass(frozen=True, kw_only=True)
class BusOptions:
    """What a command line says of the buses (:func:`add_endpoint_arguments`)."""

    loop: str = DEFAULT_LOOP
    listen: Sequence[str] = ()
    connect: Sequence[str] = ()
    client: Sequence[str] = ()
    tls: Sequence[str] = ()
    scouting: bool = False


@dataclass(frozen=True, kw_only=True)
class ServiceOptions(BusOptions):
    """What each of the services is told: also how its recording is bounded, and of many loops."""

    scenario: str | None = None
    run_dir: str | None = None
    seed: int | None = None
    check: bool = False
    part_bytes: int | None = None
    total_bytes: int | None = None
    fleet: str | None = None
    loops: int | None = None
    metrics: str | None = None


def add_endpoint_arguments(parser: argparse.ArgumentParser, service: str) -> None:
    """Add ``--loop``, ``--listen``, ``--connect``, ``--client``, ``--tls``, ``--scouting``."""
    buses = ", ".join(SERVICES[service].ends)
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


def add_end_arguments(parser: argparse.ArgumentParser, service: str) -> None:
    """Add what both ends of a loop are told alike: seed, bounds, fleets, metrics, buses."""
    parser.add_argument("--seed", type=int, metavar="N", help="for experiments: predictable draws")
    add_check_argument(parser)
    add_bounds_arguments(parser)
    add_fleet_arguments(parser)
    add_metrics_argument(parser)
    add_endpoint_arguments(parser, service)


def add_metrics_argument(parser: argparse.ArgumentParser) -> None:
    """Add ``--metrics``."""
    parser.add_argument(
        "--metrics", metavar="HOST:PORT", help="answer Prometheus there (docs/deployment.md)"
    )


def _split(option: str, values: Iterable[str], allowed: Iterable[str]) -> list[tuple[str, str]]:
    pairs = []
    for value in values:
        bus, _, rest = value.partition("=")
        if bus not in allowed or not rest:
            names = bus_names(bus, allowed)
            raise UsageError(f"{option}: got {value!r}, expected BUS=VALUE with BUS one of {names}")
        pairs.append((bus, rest))
    return pairs


def loop_of(options: BusOptions) -> str:
    """The checked ``--loop``."""
    try:
        return check_loop(options.loop)
    except ValueError as error:
        raise UsageError(f"--{error}") from None


def endpoints_of(options: BusOptions, service: str, bus: str) -> "Addresses":
    """The endpoints of one bus of a service, after the defaults and the options.

    Raises
    ------
    UsageError
        When an option names a bus that the service does not have, or what is no endpoint.
    """
    from runtime.addresses import Addresses, TlsFiles, check_endpoint
    from runtime.bus import TransportError

    defaults = SERVICES[service].ends
    listens = _split("--listen", options.listen, defaults)
    connects = _split("--connect", options.connect, defaults)
    folders = dict(_split("--tls", options.tls, defaults))
    for option, pairs in (("--listen", listens), ("--connect", connects)):
        for name, endpoint in pairs:
            try:
                check_endpoint(endpoint, f"{option} {name}", tls=name in folders)
            except TransportError as error:
                raise UsageError(str(error)) from None
    for name in options.client:
        if name not in defaults:
            expected = bus_names(name, defaults)
            raise UsageError(f"--client: got {name!r}, expected one of {expected}")
    listen, connect = defaults[bus]
    if any(name == bus for name, _ in (*listens, *connects)):
        listen = tuple(endpoint for name, endpoint in listens if name == bus)
        connect = tuple(endpoint for name, endpoint in connects if name == bus)
    return Addresses(
        listen=listen,
        connect=connect,
        client=bus in options.client,
        tls=TlsFiles.in_folder(Path(folders[bus])) if bus in folders else None,
        scouting=options.scouting,
    )


def check_addresses(options: ServiceOptions, service: str) -> None:
    """Look at the loop's id and at all addresses, before anything is started.

    Raises
    ------
    UsageError
        When one of them is none.
    """
    loop_of(options)
    for bus in SERVICES[service].ends:
        endpoints_of(options, service, bus)
    if options.metrics is not None:
        from runtime.metrics import host_and_port

        host_and_port(options.metrics)


@contextmanager
def noted(metrics: str | None, bus: "Bus") -> "Iterator[Bus]":
    """The bus on which statuses are published; at ``metrics`` Prometheus is answered too.

    Raises
    ------
    UsageError
        When it cannot be.
    """
    if metrics is None:
        yield bus
        return
    from runtime.metrics import NotedBus, Statuses, served

    statuses: Statuses = {}
    with served(metrics, statuses):
        yield NotedBus(bus, statuses)


@contextmanager
def buses_of(options: ServiceOptions, service: str) -> "Iterator[tuple[threading.Event, Bus, Bus]]":
    """The event that signals set, and the open buses field and management of a service.

    They are opened again where a freeze or a silence has left them dead.

    Raises
    ------
    UsageError
        When a bus cannot be opened.
    """
    from runtime.bus import TransportError
    from runtime.link_watchdog import watched
    from runtime.zenoh_bus import open_bus

    try:
        with (
            stop_on_signals() as stopping,
            open_bus(endpoints_of(options, service, "field")) as field,
            open_bus(endpoints_of(options, service, "management")) as management,
            watched(stopping, logger(service), field, management, listens=field),
        ):
            freeze_startup()
            with noted(options.metrics, management) as management_or_noted:
                yield stopping, field, management_or_noted
    except TransportError as error:
        raise UsageError(str(error)) from None


def fleet_of(options: ServiceOptions, message: bytes | None = None) -> "Fleet | None":
    """The fleet of ``--fleet`` or ``--loops``, if any; ``message`` is for each loop of ``--loops``.

    Raises
    ------
    UsageError
        When it is not one, or an option beside it is for a single loop.
    """
    from runtime.fleet import numbered, read_fleet

    if options.fleet is None and options.loops is None:
        return None
    if options.loop != DEFAULT_LOOP:
        raise UsageError("--loop: is for a single loop; a fleet's loops have ids of their own")
    if options.fleet is not None:
        return read_fleet(Path(options.fleet))
    assert options.loops is not None
    text = (message or b"").decode("utf-8", errors="surrogateescape")
    return numbered(options.loops, options.scenario or "", text, options.seed)
