"""``wyner dashboard``: watch a running system, on a live screen, in lines, or once."""

import argparse
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

from runtime.bus_options import BusOptions, add_service_arguments, endpoints_of, loop_of
from runtime.options import picked
from runtime.services import CONTROLLER_MANAGEMENT, PLANT_MANAGEMENT
from wyner.cli.options import add_run_argument, joined

if TYPE_CHECKING:
    from wyner.dashboard.source import BusSource

ONCE_S: Final = 10.0
"""Seconds that ``--once`` waits for both ends: each publishes a whole status every few seconds."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Watch plant and controller over the management bus and the tap over the adversary bus. "
        "Without a terminal it prints lines. In the screen, ? shows the keys."
    )
    parser.add_argument("--once", action="store_true", help="print the screen once, and end")
    add_run_argument(parser)
    add_service_arguments(parser, "dashboard")


def run(args: argparse.Namespace) -> int:
    """Watch until q or Ctrl-C, or print the screen once."""
    from protocol.text import printable
    from runtime.bus import TransportError
    from runtime.errors import DONE, INTERRUPTED, UsageError
    from runtime.link_watchdog import watched
    from runtime.logs import logger
    from runtime.signals import stop_on_signals
    from runtime.zenoh_bus import open_bus
    from wyner.dashboard.app import Ending, has_screen, run_dashboard
    from wyner.dashboard.headless import run_headless
    from wyner.dashboard.source import BusSource
    from wyner.deployment.running import listens

    run, buses = joined(picked(BusOptions, vars(args)), args.run_name, "dashboard")
    if run is not None:
        told = printable(f"joining the run {run.seen_from(Path.cwd())} ({run.scenario})")
        print(f"wyner: {told}", file=sys.stderr)
    elif not buses.connect and not any(map(listens, (PLANT_MANAGEMENT, CONTROLLER_MANAGEMENT))):
        print(
            f"wyner: no loop runs on this machine; waiting at {PLANT_MANAGEMENT} for services "
            "started by hand. Start `wyner up` first, or say --connect",
            file=sys.stderr,
        )
    loop = loop_of(buses.loop)
    management, adversary = (
        endpoints_of(buses, "dashboard", bus) for bus in ("management", "adversary")
    )
    try:
        with (
            stop_on_signals() as stopping,
            open_bus(management) as management_bus,
            open_bus(adversary) as adversary_bus,
            watched(stopping, logger("dashboard"), management_bus, adversary_bus),
        ):
            source = BusSource(management_bus, adversary_bus, loop)
            if args.once:
                return _once(source)
            if has_screen():
                ending = run_dashboard(source, until=stopping.is_set)
            else:
                ending = run_headless(source, until=stopping.is_set)
            interrupted = stopping.is_set() or ending is Ending.INTERRUPTED
    except TransportError as error:
        raise UsageError(str(error)) from None
    return INTERRUPTED if interrupted else DONE


def _once(source: "BusSource") -> int:
    """Print the screen as soon as both ends and the plant's model were received."""
    import shutil

    from rich.console import Console

    from runtime.errors import DONE, Failure
    from wyner.dashboard.app import Watch

    watch = Watch()
    until = time.monotonic() + ONCE_S
    while not watch.state.complete and time.monotonic() < until:
        time.sleep(0.1)
        watch.take(source)
    if watch.state.plant is None and watch.state.controller is None:
        raise Failure(f"no status of plant or controller was received in {ONCE_S:g} s")
    size = shutil.get_terminal_size()
    Console(width=size.columns).print(watch.draw((size.columns, size.lines), source.now_ns()))
    return DONE
