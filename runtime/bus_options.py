"""Options of the buses: where they listen and connect, whose loops they carry, who counts them."""

import argparse
import logging
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from protocol.topics import DEFAULT_LOOP, check_loop
from runtime.errors import UsageError
from runtime.link_watchdog import SILENT_S, watched
from runtime.options import add_arguments, option
from runtime.services import SERVICES, Ends

if TYPE_CHECKING:
    from runtime.addresses import Addresses
    from runtime.bus import Bus


ENDPOINTS: Final = "endpoints\nBUS is one of: {buses}; an option replaces that bus's default"


def _of_buses(help: str, metavar: str) -> Any:
    """An option that says something of one bus, and may be repeated."""
    return option(help, metavar, (), many=True, group=ENDPOINTS)


@dataclass(frozen=True, kw_only=True)
class BusOptions:
    """Where a program that joins a running loop finds its buses."""

    loop: str = option("id of the control loop", "ID", DEFAULT_LOOP, group=ENDPOINTS)
    connect: Sequence[str] = _of_buses(
        "connect to an endpoint such as tcp/127.0.0.1:7461 (repeatable)", "BUS=ENDPOINT"
    )
    client: Sequence[str] = _of_buses(
        "open this bus as a client of the router it connects to", "BUS"
    )
    tls: Sequence[str] = _of_buses(
        "mutual TLS with ca.pem, cert.pem and key.pem of this folder", "BUS=FOLDER"
    )


@dataclass(frozen=True, kw_only=True)
class ServiceOptions(BusOptions):
    """Options that each of the three services has."""

    listen: Sequence[str] = _of_buses(
        "listen at an endpoint such as tcp/127.0.0.1:7461 (repeatable)", "BUS=ENDPOINT"
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
    total_bytes: int = option(
        "largest size of the recording; its oldest parts are deleted (default: 1 GiB)",
        "N",
        2**30,
        least=2048,
    )


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


def endpoints_of(options: BusOptions, service: str) -> "dict[str, Addresses]":
    """The endpoints of each bus of a service, after the defaults and the options.

    Everything that the options say of loop and buses is checked here, before anything is started.

    Raises
    ------
    UsageError
        When the loop's id is none, an option names a bus that the service does not have, or what is
        no endpoint.
    """
    from runtime.addresses import Addresses, TlsFiles, check_endpoint

    loop_of(options.loop)
    defaults = SERVICES[service].ends
    listening: Sequence[str] = ()
    if isinstance(options, ServiceOptions):
        listening = options.listen
        if options.metrics is not None:
            from runtime.metrics import host_and_port

            host_and_port(options.metrics)
    listens = by_bus("--listen", listening, defaults)
    connects = by_bus("--connect", options.connect, defaults)
    folders = dict(by_bus("--tls", options.tls, defaults))
    for said, pairs in (("--listen", listens), ("--connect", connects)):
        for name, endpoint in pairs:
            check_endpoint(endpoint, f"{said} {name}", tls=name in folders)
    for name in options.client:
        if name not in defaults:
            expected = ", ".join(defaults)
            raise UsageError(f"--client: got {name!r}, expected one of {expected}")
    addresses = {}
    for bus, default in defaults.items():
        stated = Ends(
            listen=tuple(endpoint for name, endpoint in listens if name == bus),
            connect=tuple(endpoint for name, endpoint in connects if name == bus),
        )
        listen, connect = stated if any(stated) else default
        tls = TlsFiles.in_folder(Path(folders[bus])) if bus in folders else None
        addresses[bus] = Addresses(listen, connect, client=bus in options.client, tls=tls)
    return addresses


@contextmanager
def buses_of(
    ends: "Mapping[str, Addresses]",
    stopping: threading.Event,
    log: logging.Logger,
    metrics: str | None = None,
    silent_s: float = SILENT_S,
) -> "Iterator[tuple[Bus, Bus]]":
    """The two buses of a service, open; what it says of itself is published on the second.

    They are opened again where a freeze or a silence has left them dead.

    Parameters
    ----------
    ends : mapping
        Of each bus, from :func:`endpoints_of`.
    stopping : threading.Event
        Set where one cannot be opened again.
    log : logging.Logger
    metrics : str, optional
        Where Prometheus is answered.
    silent_s : float
        Seconds without a message on the field bus after which both are opened again.

    Raises
    ------
    UsageError
        When a bus cannot be opened.
    """
    from runtime.metrics import noted
    from runtime.zenoh_bus import open_bus

    with ExitStack() as stack:
        first, second = (stack.enter_context(open_bus(end)) for end in ends.values())
        field = first if "field" in ends else None
        stack.enter_context(watched(stopping, log, first, second, listens=field, silent_s=silent_s))
        yield first, stack.enter_context(noted(metrics, second))
