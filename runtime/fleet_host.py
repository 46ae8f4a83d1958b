"""A host that runs one end of every loop of a fleet."""

import logging
import queue
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

from protocol.link.peer import Peer
from runtime.bus import Bus
from runtime.collection import freeze_startup
from runtime.errors import Failure, UsageError
from runtime.fleet import Fleet, FleetLoop
from runtime.host import Host
from runtime.network import check_delays
from runtime.ports import Files
from runtime.scenario_file import scenario_of
from runtime.shipped import scenario_file_of

Open = Callable[[FleetLoop, int], tuple[Peer, Files]]
"""Opens one end of a loop, the nth of its host, as its journal has it.

It raises UsageError, Failure or OSError where that cannot be.
"""


def check_loops(fleet: Fleet) -> None:
    """Read the scenario of every loop, and the files that it names; start nothing.

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
            check_delays(scenario_of(scenario), scenario_file_of(scenario).parent)
        except UsageError as error:
            where = "" if fleet.path is None else f"{loop_id}: "
            problems += [f"{where}{line}" for line in error.lines]
    if problems:
        raise UsageError(problems)


class _Opened(NamedTuple):
    """A loop, and its end or why there is none."""

    loop: FleetLoop
    end: tuple[Peer, Files] | Exception


class _Opener:
    """Opens ends on a thread of its own, one after the other: a new design takes up to a minute.

    Each is taken before the next one is opened: a journal is not opened again while an end that
    nobody wants any more still holds it.

    Parameters
    ----------
    open_end : callable
    """

    def __init__(self, open_end: Open) -> None:
        self._open = open_end
        self._asked: queue.SimpleQueue[tuple[FleetLoop, int]] = queue.SimpleQueue()
        self._opened: queue.SimpleQueue[_Opened] = queue.SimpleQueue()
        self._taken = threading.Semaphore(0)
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None

    def ask(self, loop: FleetLoop, number: int) -> None:
        """Have a loop's end opened."""
        self._asked.put((loop, number))
        if self._thread is None:
            thread = threading.Thread(target=self._run, name="opener", daemon=True)
            thread.start()
            self._thread = thread

    def take(self, use: Callable[[_Opened], None]) -> None:
        """Have ``use`` called with each that is open now."""
        with suppress(queue.Empty):
            while True:
                opened = self._opened.get_nowait()
                try:
                    use(opened)
                finally:
                    self._taken.release()

    def close(self) -> None:
        """No more are wanted; one that is being opened is closed by its thread, or by its end."""
        self._closing.set()
        self.take(_closed)

    def _run(self) -> None:
        while True:
            loop, number = self._asked.get()
            if self._closing.is_set():
                return
            opened = _try(self._open, loop, number)
            if self._closing.is_set():
                _closed(opened)
                return
            self._opened.put(opened)
            self._taken.acquire()


def _try(open_end: Open, loop: FleetLoop, number: int) -> _Opened:
    try:
        return _Opened(loop, open_end(loop, number))
    except Exception as error:
        return _Opened(loop, error)


def _closed(opened: _Opened) -> None:
    """Close an end that is not wanted any more; it has not begun."""
    if not isinstance(opened.end, Exception):
        opened.end[1].close()


def run_fleet(
    fleet: Fleet,
    open_end: Open,
    field: Bus,
    management: Bus,
    stopping: threading.Event,
    log: logging.Logger,
) -> int:
    """Run one end of every loop of a fleet until told to stop; returns the exit code.

    A loop that cannot be opened, or fails, is logged, and harms no other. One that joins later is
    opened beside the others' timers.
    """
    known: dict[str, FleetLoop] = {}
    opener = _Opener(open_end)

    def add(opened: _Opened) -> bool:
        loop, end = opened
        if known.get(loop.id) is not loop:  # it left while it was opened
            _closed(opened)
            return False
        if isinstance(end, UsageError | Failure | OSError):
            log.error("loop %s: %s", loop.id, str(end).replace("\n", "; "))
            return False
        if isinstance(end, Exception):
            raise end
        host.add(loop.id, *end, log.getChild(loop.id))
        return True

    def joined(opened: _Opened) -> None:
        if add(opened):
            log.info("loop %s has joined", opened.loop.id)

    def follow() -> None:
        opener.take(joined)
        for name in fleet.left(known, log):
            host.remove(name)
            del known[name]
            log.info("loop %s has left", name)
        for name, loop in fleet.loops.items():
            if name not in known:
                known[name] = loop
                opener.ask(loop, len(known))

    host = Host(field, management, stopping, fleet=True, chore=follow)
    for loop in fleet.loops.values():
        known[loop.id] = loop
        add(_try(open_end, loop, len(known)))
    freeze_startup()
    log.info("%d of %d loops run", len(host.loops), len(known))
    try:
        return host.run()
    finally:
        opener.close()
