"""The taps of a fleet in one process: one subscription, a recording for each loop.

Each loop has a tap of its own, with all that it heard and guessed below the loop's folder. Heavy
eavesdroppers, which need a process each, read the recordings afterwards (``wyner score``).
"""

import os
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, suppress
from typing import TYPE_CHECKING, Final

from protocol.errors import WynerError
from protocol.messages import FIELD
from protocol.topics import every_loop
from runtime.bus_options import buses_of
from runtime.collection import freeze_startup
from runtime.errors import DONE, Failure, UsageError
from runtime.fleet import FleetLoop
from runtime.logs import logger
from runtime.signals import stop_on_signals
from tap_service.config import SILENT_S, TapConfig
from tap_service.service import TapService

if TYPE_CHECKING:
    from runtime.addresses import Addresses
    from runtime.bus import Bus

TELL_S: Final = 2.0
"""Between two statuses of one loop's tap, and between two writings of its beliefs."""

ROUND_S: Final = 0.2
"""Rest between two rounds through all taps: what gathered of a loop meanwhile is one write. In each
a share of the loops is told of, all in :data:`TELL_S`."""


NICENESS: Final = 10
"""Guessing gives way to the loop where they share a processor."""


def run_tap(
    make: Callable[[], "TapService | TapFleet"],
    ends: "Mapping[str, Addresses]",
    metrics: str | None,
) -> int:
    """Run until SIGTERM or SIGINT; returns the exit code.

    Parameters
    ----------
    make : callable
    ends : mapping
        Of the buses field and adversary.
    metrics : str, optional
        Where Prometheus is answered.

    Raises
    ------
    KnowledgeError
        When an eavesdropper cannot be made.
    UsageError
        When a bus cannot be opened; nothing has started in either case.
    """
    with stop_on_signals() as stopping:
        # Eavesdroppers are made first: from the moment that a bus is open whoever waits for the
        # tap goes on, and what is said then must be heard.
        service = make()
        with (
            closing(service),
            buses_of(ends, stopping, service.log, metrics, SILENT_S) as (field, adversary),
        ):
            service.attach(field, adversary)
            # On Linux this is the calling thread's alone: the transport's threads, already
            # running, still take messages off the wire at once.
            os.nice(NICENESS)
            freeze_startup()
            service.run(stopping)
    return DONE


class TapFleet:
    """The taps of the loops of a fleet.

    Parameters
    ----------
    loops : sequence of FleetLoop
    config_of : callable
        What the tap of one loop is told; raises `UsageError` where that cannot be.
    """

    def __init__(
        self, loops: Sequence[FleetLoop], config_of: Callable[[FleetLoop], TapConfig]
    ) -> None:
        self._loops = loops
        self._config_of = config_of
        self.log = logger("tap")
        self.taps: dict[str, TapService] = {}
        self._by_key: dict[str, TapService] = {}
        self._adversary: Bus | None = None
        self._next = 0

    def attach(self, field: "Bus", adversary: "Bus") -> None:
        """Listen to every loop at once, and take the fleet's in."""
        self._adversary = adversary
        for loop in self._loops:
            self._open(loop)
        for tap in self.taps.values():
            tap.share(len(self.taps))
        for kind in FIELD:
            field.subscribe(every_loop(kind), self._deliver, patient=True)
        self.log.info("listening on %d of %d loops", len(self.taps), len(self._loops))

    def _deliver(self, key: str, payload: bytes, t_ns: int) -> None:
        tap = self._by_key.get(key)
        if tap is not None:
            tap.deliver(key, payload, t_ns)

    def _open(self, loop: FleetLoop) -> None:
        assert self._adversary is not None
        try:
            tap = TapService(self._config_of(loop))
            tap.begin()
        except (UsageError, Failure, WynerError, OSError) as error:
            self.log.error("loop %s: not listened to: %s", loop.id, error)
            return
        tap.publish_on(self._adversary, many=True)
        self.taps[loop.id] = tap
        self._by_key |= dict.fromkeys(tap.keys, tap)

    def _let(self, name: str, do: Callable[[TapService], None], *, last: bool = False) -> None:
        """Have one loop's tap do something; after its ``last``, or a failure, it ends alone."""
        tap = self.taps[name]
        try:
            do(tap)
            if not last:
                return
        except Exception as error:
            self.log.error("loop %s: its tap failed: %s: %s", name, type(error).__name__, error)
            with suppress(Exception):
                tap.write_beliefs()
        del self.taps[name]
        for key in tap.keys:
            del self._by_key[key]
        tap.close()

    def close(self) -> None:
        """End the files of those that were not finished."""
        for name in list(self.taps):
            self._let(name, lambda tap: tap.write_beliefs(), last=True)

    def run(self, stopping: threading.Event) -> None:
        """Record and guess until ``stopping``; then settle what is left."""
        while not stopping.is_set():
            for name in list(self.taps):
                self._let(name, lambda tap: tap.work(0.0))
            time.sleep(ROUND_S)
            self._tell()
        for name in list(self.taps):
            self._let(name, lambda tap: tap.finish(), last=True)

    def _tell(self) -> None:
        """Tell of the next few loops; each has its turn once in :data:`TELL_S`."""
        names = list(self.taps)
        share = -(-len(names) * ROUND_S // TELL_S)
        for _ in range(int(share)):
            name = names[self._next % len(names)]
            self._next += 1
            if name in self.taps:
                self._let(name, _tell_of)


def _tell_of(tap: TapService) -> None:
    tap.publish()
    tap.write_beliefs()
