"""Which running loop ``wyner send`` and ``wyner dashboard`` join."""

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from protocol.text import printable
from protocol.topics import DEFAULT_LOOP
from runtime.bus_options import BusOptions
from runtime.errors import Failure, UsageError
from runtime.services import CONTROLLER_MANAGEMENT, SERVICES

if TYPE_CHECKING:
    from wyner.deployment.running import RunningLoop


POLL_S: Final = 0.1
"""Seconds between two looks for a run that is only being started."""


def add_run_argument(parser: argparse.ArgumentParser) -> None:
    """Add ``--run``."""
    parser.add_argument(
        "--run",
        dest="run_name",
        metavar="NAME",
        help="which run of `wyner up` to join, by its folder's name, where there are several",
    )


def joined(
    buses: BusOptions, run_name: str | None, service: str, wait_s: float = 0.0, *, own: bool = False
) -> "tuple[RunningLoop | None, BusOptions]":
    """The run that is meant, and where its services are.

    The run that ``--run`` names. Without a name, the loop that ``--connect``, ``--client`` or
    ``--loop`` names, which need not be on this machine. Without any of these, the one loop on this
    machine: a run, or services started by hand, which listen at the default endpoints.

    Parameters
    ----------
    buses : BusOptions
    run_name : str, optional
        What ``--run`` says: a run's folder, or the last parts of it.
    service : str
        Who joins.
    wait_s : float, optional
        How long to wait for a loop that is only being started; standard error has a line on it.
    own : bool, optional
        Refuse a loop that no option names unless it is a run of this folder: it may be a
        stranger's.

    Returns
    -------
    RunningLoop or None
        None where it is no run of ``wyner up``.
    BusOptions
        With the run's endpoints in place of the defaults.

    Raises
    ------
    UsageError
        When no run or several have this name, when several loops run and no option names one, or
        when the one that runs is not ``own``.
    Failure
        When no loop runs after ``wait_s``.
    """
    from wyner.deployment.running import listens, run_names, running_loops

    if run_name is None and (buses.connect or buses.client or buses.loop != DEFAULT_LOOP):
        return None, buses
    until = time.monotonic() + wait_s
    waits = False
    while True:
        loops = running_loops()
        found = [loop for loop in loops if run_name is None or loop.is_called(run_name)]
        by_hand = run_name is None and listens(CONTROLLER_MANAGEMENT)
        if found or by_hand or time.monotonic() >= until:
            break
        if not waits:
            waits = True
            which = "no run" if run_name is None else f"no run {run_name!r}"
            told = f"{which} on this machine yet; waiting {wait_s:g} s for it"
            print(f"wyner: {told}", file=sys.stderr)
        time.sleep(POLL_S)
    names = run_names(loops)
    if run_name is not None and len(found) != 1:
        many = f"{len(found)} runs end in {run_name!r}" if found else f"no run {run_name!r}"
        raise UsageError(f"--run: {many} on this machine, running now: {names}")
    if len(found) > 1:
        raise UsageError(f"{len(found)} runs on this machine, expected --run with one of: {names}")
    if found and by_hand:
        raise UsageError(
            f"two loops on this machine: run {names}, and services at {CONTROLLER_MANAGEMENT}; "
            f"expected --run {names}, or --connect for the other"
        )
    if not found and not by_hand and wait_s:
        raise Failure(
            f"no run on this machine within {wait_s:g} s: start one (wyner up; it is there "
            "once its design is computed), or say where it is (--connect BUS=tcp/HOST:PORT)"
        )
    if not found and own:
        raise UsageError(
            f"no run of this user on this machine, and services at {CONTROLLER_MANAGEMENT} that "
            "may be anybody's; where they are meant expected "
            f"--connect management={CONTROLLER_MANAGEMENT}"
        )
    if not found:
        return None, buses
    loop = found[0]
    if own and run_name is None and not Path(loop.run_dir).is_relative_to(Path.cwd()):
        raise UsageError(
            f"the one run on this machine, {printable(loop.run_dir)}, is not of this folder; where "
            f"it is meant expected --run {printable(names)}"
        )
    ends = {
        "management": (loop.plant_management, loop.controller_management),
        "adversary": (loop.adversary,),
    }
    connect = [f"{bus}={end}" for bus in SERVICES[service].ends for end in ends.get(bus, ())]
    return loop, replace(buses, loop=DEFAULT_LOOP, connect=connect)
