"""Where the dashboard's messages come from: two buses."""

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from pydantic import ValidationError

from protocol.messages import ControllerStatus, Message, PlantModel, PlantStatus, TapStatus
from protocol.topics import key_of
from runtime.inbox import Inbox
from wyner.dashboard.model import Arrival

if TYPE_CHECKING:
    from runtime.bus import Bus

WAITING_AT_MOST: Final = 32 * 2**20
"""Bytes held between two looks; what comes beyond is dropped and counted."""


class BusSource:
    """Subscribes to the statuses of one loop over the management and the adversary bus.

    Callbacks of the buses only put into an inbox; parsing happens in `drain`, on the caller's
    thread. Closing the buses is the caller's.

    Parameters
    ----------
    management_bus, adversary_bus : runtime.bus.Bus
        Open buses.
    loop : str
        The loop's id.
    """

    def __init__(self, management_bus: "Bus", adversary_bus: "Bus", loop: str) -> None:
        self._types: dict[str, type[Message]] = {}
        self._waiting: Inbox[tuple[str, bytes, int]] = Inbox(WAITING_AT_MOST)
        self._malformed = 0
        for kind in (PlantModel, PlantStatus, ControllerStatus, TapStatus):
            key = key_of(kind, loop)
            self._types[key] = kind
            bus = adversary_bus if kind is TapStatus else management_bus
            bus.subscribe(key, self._deliver)

    def _deliver(self, key: str, payload: bytes, _sent_ns: int) -> None:
        # On a foreign thread.
        self._waiting.put((key, payload, time.monotonic_ns()), len(payload))

    def drain(self) -> Sequence[Arrival]:
        """All that came since the last call, parsed, oldest first; it never waits."""
        arrivals = []
        for _ in range(len(self._waiting)):
            key, payload, t_ns = self._waiting.get(0.0)
            message: Message | None = None
            try:
                message = self._types[key].model_validate_json(payload)
            except (ValidationError, KeyError):
                self._malformed += 1
            arrivals.append(Arrival(t_ns, message))
        return arrivals

    def now_ns(self) -> int:
        """The time now, of the clock that arrivals are stamped with."""
        return time.monotonic_ns()

    def problems(self) -> Sequence[str]:
        """What went wrong so far, a line each, to be repeated after the screen closes."""
        lines = []
        if self._malformed:
            lines.append(f"dashboard: {self._malformed} payloads were no message of their key")
        if dropped := self._waiting.dropped:
            lines.append(f"dashboard: {dropped} messages came faster than they were read")
        return lines
