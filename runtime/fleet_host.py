"""A host that runs one end of every loop of a fleet."""

import logging
import threading
from collections.abc import Callable

from protocol.link.endpoint import Endpoint
from runtime.bus import Bus
from runtime.collection import freeze_startup
from runtime.errors import Failure, UsageError
from runtime.fleet import Fleet, FleetLoop
from runtime.host import Host
from runtime.ports import Files
from runtime.scenario_file import scenario_of

Open = Callable[[FleetLoop, int], tuple[Endpoint, Files]]
"""Opens one end of a loop, the nth of its host, as its journal has it.

It raises UsageError, Failure or OSError where that cannot be.
"""


def check_loops(fleet: Fleet) -> None:
    """Read the scenario of every loop; start nothing.

    Raises
    ------
    UsageError
        With the lines of each scenario that is wrong; where loops stand in a file, after the first
        one that has it.
    """
    first: dict[str, str] = {}
    for loop in fleet.loops.values():
        first.setdefault(loop.scenario, loop.id)
    problems: list[str] = []
    for scenario, loop_id in first.items():
        try:
            scenario_of(scenario)
        except UsageError as error:
            where = "" if fleet.path is None else f"{loop_id}: "
            problems += [f"{where}{line}" for line in error.lines]
    if problems:
        raise UsageError(problems)


def run_fleet(
    fleet: Fleet,
    open_end: Open,
    field: Bus,
    management: Bus,
    stopping: threading.Event,
    log: logging.Logger,
) -> int:
    """Run one end of every loop of a fleet until told to stop; returns the exit code.

    A loop that cannot be opened, or fails, is logged, and harms no other.
    """
    host = Host(field, management, stopping, fleet=True)
    for number, loop in enumerate(fleet.loops.values(), start=1):
        try:
            host.add(loop.id, *open_end(loop, number), log.getChild(loop.id))
        except (UsageError, Failure, OSError) as error:
            log.error("loop %s: %s", loop.id, str(error).replace("\n", "; "))
        except Exception as error:
            log.error("loop %s: unexpected %s: %s", loop.id, type(error).__name__, error)
    freeze_startup()
    log.info("%d of %d loops run", len(host.loops), len(fleet.loops))
    return host.run()
