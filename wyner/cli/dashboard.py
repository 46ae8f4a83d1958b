"""``wyner dashboard``: watch a running system, on a live screen, in lines, or once."""

import argparse
import sys
from pathlib import Path

from runtime.bus_options import BusOptions, add_service_arguments, buses_of, endpoints_of
from runtime.options import picked
from runtime.services import CONTROLLER_MANAGEMENT, PLANT_MANAGEMENT
from wyner.cli.joining import add_run_argument, joined


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = (
        "Watch plant and controller over the management bus and the tap over the adversary bus. "
        "Without a terminal it prints lines. In the screen, ? shows the keys."
    )
    add_run_argument(parser)
    add_service_arguments(parser, "dashboard")


def run(args: argparse.Namespace) -> int:
    """Watch until q or Ctrl-C."""
    from protocol.text import printable
    from runtime.errors import DONE, INTERRUPTED
    from runtime.logs import logger
    from runtime.signals import stop_on_signals
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
    ends = endpoints_of(buses, "dashboard")
    with (
        stop_on_signals() as stopping,
        buses_of(ends, stopping, logger("dashboard")) as (management, adversary),
    ):
        source = BusSource(management, adversary, buses.loop)
        if has_screen():
            ending = run_dashboard(source, until=stopping.is_set)
        else:
            ending = run_headless(source, until=stopping.is_set)
        interrupted = stopping.is_set() or ending is Ending.INTERRUPTED
    return INTERRUPTED if interrupted else DONE
