"""Opens sessions of the bus again that a freeze or a silence has left dead.

A process that was frozen (SIGSTOP, a paused container, a laptop that slept) for longer than a
lease finds sessions that its partners have given up. Zenoh 1.10 may then take a partner's new link
for a part of the old session, and nothing comes through it any more although it is open on both
sides. The same can follow on a network that was cut. So each end opens its sessions again when its
own clock has jumped, and when nothing comes although the transport says that somebody is there.
"""

import logging
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from math import inf
from typing import Final, Protocol

from runtime.bus import TransportError
from runtime.errors import Failure

LOOK_S: Final = 0.2
"""Seconds between two looks."""

FROZEN_S: Final = 1.4
"""Seconds between two looks by which this process stood still for so long that a partner may have
given it up: the lease of 2 s, less the 0.5 s between two signs of life."""

SETTLE_S: Final = 0.4
"""Seconds after a freeze in which links come up that were being opened meanwhile. A session that is
closed while it accepts one keeps it, and its other side takes it for the new session's."""

SILENT_S: Final = 2.5
"""Seconds without a message after which a session is opened again, at least. Each time in a row
takes twice as long, and so does a silence after messages that came far apart: a slow plant's."""

SILENT_AT_MOST_S: Final = 60.0


class Reopens(Protocol):
    """A bus that can be opened again: a :class:`runtime.zenoh_bus.ZenohBus`."""

    received: int
    """Messages that have come."""

    def links(self) -> frozenset[tuple[str, str]]:
        """The links that the transport says are open."""

    def reopen(self) -> None:
        """Open it again, and everything on it."""


class LinkWatchdog:
    """Looks after the buses of a process; time is an argument.

    Parameters
    ----------
    buses : sequence of Reopens
        Opened again after a freeze of this process.
    log : logging.Logger
    listens : Reopens, optional
        The one on which something comes as long as somebody is there; after a silence it is opened
        again, and the others with it.
    silent_s : float
        How long a silence is at least.
    """

    def __init__(
        self,
        buses: Sequence[Reopens],
        log: logging.Logger,
        listens: Reopens | None = None,
        silent_s: float = SILENT_S,
    ) -> None:
        self._buses, self._log, self._listens = buses, log, listens
        self._least_s = self._patience_s = silent_s
        self._looked_at = inf
        self._since = self._came_at = inf
        self._received = -1
        self._links: frozenset[tuple[str, str]] = frozenset()

    def look(self, now: float) -> None:
        """Look at all of them.

        Raises
        ------
        TransportError
            When one cannot be opened again.
        """
        stood_still_s, self._looked_at = now - self._looked_at, now
        if stood_still_s >= FROZEN_S:
            time.sleep(SETTLE_S)
            self._reopen(now, f"this process stood still for {stood_still_s:.1f} s")
        elif self._silent(now):
            silent_s = now - self._since
            self._patience_s = min(2 * self._patience_s, SILENT_AT_MOST_S)
            self._reopen(now, f"nothing has come for {silent_s:.0f} s, though somebody is there")

    def _silent(self, now: float) -> bool:
        bus = self._listens
        if bus is None:
            return False
        links = bus.links()
        if bus.received != self._received:
            apart_s = now - self._came_at
            self._patience_s = min(max(self._least_s, 2 * apart_s), SILENT_AT_MOST_S)
            self._received, self._since = bus.received, now
            self._came_at = now
        elif links - self._links:  # somebody has just come
            self._since, self._patience_s = now, self._least_s
        elif not links:
            self._since = now
        self._links = links
        return now - self._since >= self._patience_s

    def _reopen(self, now: float, why: str) -> None:
        began = time.monotonic()
        self._log.warning("%s: the sessions of the bus are opened again", why)
        for bus in self._buses:
            bus.reopen()
        took_s = time.monotonic() - began
        self._looked_at = self._since = now + took_s
        if self._listens is not None:
            self._links = self._listens.links()


def seconds() -> float:
    """Of a clock that also goes on while the machine sleeps, where there is one."""
    clock = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
    return time.clock_gettime(clock)


@contextmanager
def watched(
    stopping: threading.Event,
    log: logging.Logger,
    *buses: Reopens,
    listens: Reopens | None = None,
    silent_s: float = SILENT_S,
) -> Iterator[None]:
    """Look after buses on a thread of its own for as long as the block lasts.

    Where one cannot be opened again the event is set, which ends the process in order.

    Raises
    ------
    Failure
        At the end, when one could not be opened again.
    """
    watchdog = LinkWatchdog(buses, log, listens, silent_s)
    over = threading.Event()
    failed: list[TransportError] = []

    def look() -> None:
        try:
            while not (over.wait(LOOK_S) or stopping.is_set()):
                watchdog.look(seconds())
        except TransportError as error:
            failed.append(error)
            stopping.set()

    threading.Thread(target=look, name="link watchdog", daemon=True).start()
    try:
        yield
    finally:
        over.set()
    if failed:
        raise Failure(f"the bus cannot be opened again: {failed[0]}")
