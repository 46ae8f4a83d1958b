"""An attack on the field bus: between two buses, it reads and rewrites both directions.

The plant connects to one bus, the controller to the other, and nothing passes but what is passed
on here.
"""

import queue
import threading
from collections.abc import Callable
from typing import Final, NamedTuple

from protocol.link.filters import Filter
from protocol.messages import FieldMessage, Measurement, Offer
from protocol.topics import key_of
from runtime.bus import Bus
from runtime.inbox import Inbox

POLL_S: Final = 0.1


class _Passed(NamedTuple):
    """A message on its way."""

    kind: type[FieldMessage]
    payload: bytes


class Relay:
    """Passes the messages of one loop on, from bus to bus.

    Parameters
    ----------
    attacker : Filter
        On the bus.
    plant, controller : Bus
        The bus on which the plant is, and that on which the controller is.
    loop : str
    """

    def __init__(self, attacker: Filter, plant: Bus, controller: Bus, loop: str) -> None:
        self._inbox: Inbox[_Passed] = Inbox()
        self._put: dict[type[FieldMessage], Callable[[bytes], None]] = {
            Measurement: controller.publisher(key_of(Measurement, loop)).put,
            Offer: plant.publisher(key_of(Offer, loop)).put,
        }
        self._hooks = {Measurement: attacker.outgoing, Offer: attacker.incoming}
        self._listen(Measurement, plant, loop)
        self._listen(Offer, controller, loop)

    def _listen(self, kind: type[FieldMessage], bus: Bus, loop: str) -> None:
        def deliver(_key: str, payload: bytes, _t_ns: int) -> None:
            self._inbox.put(_Passed(kind, payload), len(payload))

        bus.subscribe(key_of(kind, loop), deliver)

    def run(self, stopping: threading.Event) -> None:
        """Pass messages on until ``stopping``."""
        while not stopping.is_set():
            try:
                kind, payload = self._inbox.get(POLL_S)
            except queue.Empty:
                continue
            self._put[kind](self._hooks[kind](kind, payload))
