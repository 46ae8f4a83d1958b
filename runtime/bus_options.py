"""Options of the buses: where they listen and connect, whose loops they carry, who counts them."""

import argparse
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from protocol.topics import DEFAULT_LOOP, check_loop
from runtime.collection import freeze_startup
from runtime.errors import UsageError
from runtime.logs import logger
from runtime.options import add_arguments, option
from runtime.services import SERVICES
from runtime.signals import stop_on_signals

if TYPE_CHECKING:
    from runtime.addresses import Addresses
    from runtime.bus import Bus
    from runtime.fleet import Fleet
    from runtime.recording import Bounds


ENDPOINTS: Final = "endpoints\nBUS is one of: {buses}; an option replaces that bus's default"


@dataclass(frozen=True, kw_only=True)
class BusOptions:
    """Where a program that joins a running loop finds its buses."""

    loop: str = option("id of the control loop", "ID", DEFAULT_LOOP, group=ENDPOINTS)
    connect: Sequence[str] = option(
        "connect to an endpoint such as tcp/127.0.0.1:7461 (repeatable)",
        "BUS=ENDPOINT",
        (),
        many=True,
        group=ENDPOINTS,
    )
    client: Sequence[str] = option(
        "open this bus as a client of the router it connects to",
        "BUS",
        (),
        many=True,
        group=ENDPOINTS,
    )
    tls: Sequence[str] = option(
        "mutual TLS with ca.pem, cert.pem and key.pem of this folder",
        "BUS=FOLDER",
        (),
        many=True,
        group=ENDPOINTS,
    )


@dataclass(frozen=True, kw_only=True)
class ServiceOptions(BusOptions):
    """Options that each of the three services has."""

    listen: Sequence[str] = option(
        "listen at an endpoint such as tcp/127.0.0.1:7461 (repeatable)",
        "BUS=ENDPOINT",
        (),
        many=True,
        group=ENDPOINTS,
    )

    scenario: str | None = option("file or shipped name", "S")
    run_dir: str | None = option("folder of the journal and the traces", "D")
    seed: int | None = option(
        "seed of all random numbers, for experiments: nothing is secret then", "N", least=0
    )
    check: bool = option("check options and scenario, and start nothing", default=False)
    fleet: str | None = option(
        "run many loops: those of FILE, or N of --scenario (docs/deployment.md)", "FILE|N"
    )
    metrics: str | None = option("serve Prometheus metrics there (docs/deployment.md)", "HOST:PORT")
    total_bytes: int | None = option(
        "largest size of the recording; its oldest parts are deleted (default: 1 GiB)",
        "N",
        least=2048,
    )

    @property
    def bounds(self) -> "Bounds":
        """Of the recording."""
        from runtime.recording import Bounds

        return Bounds() if self.total_bytes is None else Bounds(total_bytes=self.total_bytes)


def add_service_arguments(
    parser: argparse.ArgumentParser, service: str, kind: type[BusOptions] = BusOptions
) -> None:
    """Add the options of a dataclass that has those of the buses of a service."""
    add_arguments(parser, kind, buses=", ".join(SERVICES[service].ends))


def by_bus(option: str, values: Iterable[str], allowed: Iterable[str]) -> list[tuple[str, str]]:
    """The bus and the value of each ``BUS=VALUE``.

    Raises
    ------
    UsageError
        When one does not read so.
    """
    pairs = []
    for value in values:
        bus, _, rest = value.partition("=")
        if bus not in allowed or not rest:
            names = ", ".join(allowed)
            raise UsageError(f"{option}: got {value!r}, expected BUS=VALUE with BUS one of {names}")
        pairs.append((bus, rest))
    return pairs


def loop_of(loop: str) -> str:
    """The checked ``--loop``."""
    try:
        return check_loop(loop)
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
    listening = options.listen if isinstance(options, ServiceOptions) else ()
    listens = by_bus("--listen", listening, defaults)
    connects = by_bus("--connect", options.connect, defaults)
    folders = dict(by_bus("--tls", options.tls, defaults))
    for said, pairs in (("--listen", listens), ("--connect", connects)):
        for name, endpoint in pairs:
            try:
                check_endpoint(endpoint, f"{said} {name}", tls=name in folders)
            except TransportError as error:
                raise UsageError(str(error)) from None
    for name in options.client:
        if name not in defaults:
            expected = ", ".join(defaults)
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
    )


def check_addresses(options: ServiceOptions, service: str) -> None:
    """Look at the loop's id and at all addresses, before anything is started.

    Raises
    ------
    UsageError
        When one of them is none.
    """
    loop_of(options.loop)
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
    """The fleet of ``--fleet``, if any; ``message`` is for each loop of a numbered one.

    Raises
    ------
    UsageError
        When it is not one, or an option beside it is for a single loop.
    """
    from runtime.fleet import numbered, read_fleet, text_of

    if options.fleet is None:
        return None
    if options.loop != DEFAULT_LOOP:
        raise UsageError("--loop: is for a single loop; a fleet's loops have ids of their own")
    if not options.fleet.isdecimal():
        return read_fleet(Path(options.fleet))
    return numbered(int(options.fleet), options.scenario or "", text_of(message), options.seed)
