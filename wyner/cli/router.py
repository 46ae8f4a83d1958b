"""``wyner router``: a Zenoh router for one or several buses, with access control by certificate."""

import argparse
from contextlib import ExitStack
from pathlib import Path

from runtime.bus_options import by_bus
from runtime.errors import DONE, UsageError
from runtime.logs import logger
from runtime.services import BUSES
from runtime.signals import stop_on_signals


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Relay a bus between services that connect as clients (--client BUS). Each bus "
        "gets a router of its own inside the process, so that nothing crosses from one to another. "
        "With --tls, the names in the certificates decide who may publish what; a message that "
        "they do not allow is dropped and not logged. Routers are not joined to one another: all "
        "services of a bus connect to the same one."
    )
    parser.add_argument(
        "--listen",
        action="append",
        required=True,
        metavar="BUS=ENDPOINT",
        help="carry this bus at an endpoint such as tcp/127.0.0.1:7447 (repeatable); BUS is "
        "field, management or adversary",
    )
    parser.add_argument(
        "--tls",
        action="append",
        default=[],
        metavar="BUS=FOLDER",
        help="mutual TLS with ca.pem, cert.pem and key.pem of this folder, and access control by "
        "the names in the certificates",
    )


def run(args: argparse.Namespace) -> int:
    """Relay until a signal comes."""
    from runtime.addresses import TlsFiles, check_endpoint
    from runtime.link_watchdog import watched
    from runtime.zenoh_bus import ZenohBus, open_router
    from wyner.deployment.access import access_control

    listens: dict[str, list[str]] = {}
    for bus, endpoint in by_bus("--listen", args.listen, BUSES):
        listens.setdefault(bus, []).append(endpoint)
    folders: dict[str, str] = {}
    for bus, folder in by_bus("--tls", args.tls, BUSES):
        if bus not in listens:
            raise UsageError(f"--tls {bus}: expected --listen {bus}=ENDPOINT as well")
        if bus in folders:
            raise UsageError(f"--tls {bus}: got several folders, expected one")
        folders[bus] = folder
    log = logger("router")
    for bus, endpoints in listens.items():
        for endpoint in endpoints:
            check_endpoint(endpoint, f"--listen {bus}", tls=bus in folders)
    with stop_on_signals() as stopping, ExitStack() as stack:
        routers: list[ZenohBus] = []
        for bus, endpoints in listens.items():
            tls = TlsFiles.in_folder(Path(folders[bus])) if bus in folders else None
            rules = access_control(bus) if bus in folders else None
            routers.append(stack.enter_context(open_router(endpoints, tls, rules)))
            log.info(
                "%s at %s, %s",
                bus,
                ", ".join(endpoints),
                "guarded by certificate" if rules else "open to whoever connects",
            )
        stack.enter_context(watched(stopping, log, *routers))
        stopping.wait()
        log.info("stopping")
    return DONE
