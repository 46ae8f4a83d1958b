"""A host that runs one end of every loop of a fleet."""

import logging
import threading
from collections.abc import Callable

from protocol.link.endpoint import Endpoint
from protocol.runtime.bus import Bus
from protocol.runtime.collection import freeze_startup
from protocol.runtime.errors import Failure, UsageError
from protocol.runtime.fleet import Fleet, FleetLoop
from protocol.runtime.host import Host
from protocol.runtime.ports import Files

Open = Callable[[FleetLoop, int], tuple[Endpoint, Files]]
"""Opens one end of a loop, the nth of its host, as its journal has it.

It raises UsageError, Failure or OSError where that cannot be.
"""


def run_fleet(
    fleet: Fleet,
    open_end: Open,
    field: Bus,
    ops: Bus,
    stopping: threading.Event,
    log: logging.Logger,
) -> int:
    """Run one end of every loop of a fleet until told to stop; returns the exit code.

    A loop that cannot be opened, or fails, is logged, and harms no other.
    """
    known: dict[str, FleetLoop] = {}

    def open_one(loop: FleetLoop) -> bool:
        known[loop.id] = loop
        try:
            endpoint, files = open_end(loop, len(known))
        except (UsageError, Failure, OSError) as error:
            log.error("loop %s: %s", loop.id, str(error).replace("\n", "; "))
            return False
        host.add(loop.id, endpoint, files, log.getChild(loop.id))
        return True

    def follow() -> None:
        for name in fleet.left(known, log):
            host.remove(name)
            del known[name]
            log.info("loop %s has left", name)
        for name, loop in fleet.loops.items():
            if name not in known and open_one(loop):
                log.info("loop %s has joined", name)

    host = Host(field, ops, stopping, fleet=True, chore=follow)
    for loop in fleet.loops.values():
        open_one(loop)
    freeze_startup()
    log.info("%d of %d loops run", len(host.loops), len(known))
    return host.run()
