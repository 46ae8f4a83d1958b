"""Options of those who join a loop that runs already."""

import argparse
import sys
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from protocol.topics import DEFAULT_LOOP
from runtime.bus_options import BusOptions
from runtime.errors import Failure
from runtime.services import SERVICES

if TYPE_CHECKING:
    from wyner.deployment.running import RunningLoop


POLL_S: Final = 0.1
"""Between two looks for a run that is only being started."""


def add_run_argument(parser: argparse.ArgumentParser) -> None:
    """Add ``--run``, for those who join a loop that runs already."""
    parser.add_argument(
        "--run",
        dest="run_name",
        metavar="NAME",
        help="which run of `wyner up` to join, by its folder's name, where there are several",
    )


def is_told(buses: BusOptions) -> bool:
    """Whether an option says where the loop is, or which one is meant."""
    return bool(buses.connect or buses.client) or buses.loop != DEFAULT_LOOP


def joined(
    buses: BusOptions, run_name: str | None, service: str, wait_s: float = 0.0
) -> "tuple[RunningLoop | None, BusOptions]":
    """The loop on this machine that is meant where no option says where to connect.

    Parameters
    ----------
    buses : BusOptions
    run_name : str, optional
        The run that ``--run`` names.
    service : str
        Who joins.
    wait_s : float, optional
        How long to wait for one that is only being started; standard error is told of it.

    Returns
    -------
    RunningLoop or None
    BusOptions
        With its endpoints in place of the defaults.

    Raises
    ------
    UsageError
        When several run and none was named, or the one named does not run.
    Failure
        When none runs after ``wait_s``.
    """
    from wyner.deployment.running import chosen, is_there

    if is_told(buses) and run_name is None:
        return None, buses
    if wait_s and not is_there(run_name):
        which = "no run" if run_name is None else f"no run {run_name!r}"
        print(f"wyner: {which} on this machine yet; waiting {wait_s:g} s for it", file=sys.stderr)
        until = time.monotonic() + wait_s
        while time.monotonic() < until and not is_there(run_name):
            time.sleep(POLL_S)
        if run_name is None and not is_there(None):
            raise Failure(
                f"no run on this machine within {wait_s:g} s: start one (wyner up; it is there "
                "once its design is computed), or say where it is (--connect BUS=tcp/HOST:PORT)"
            )
    loop = chosen(run_name)
    if loop is None:
        return None, buses
    ends = {
        "management": (loop.plant_management, loop.controller_management),
        "adversary": (loop.adversary,),
    }
    connect = [f"{bus}={end}" for bus in SERVICES[service].ends for end in ends.get(bus, ())]
    return loop, replace(buses, loop=DEFAULT_LOOP, connect=connect)
