"""Where the dashboard's messages come from: two buses, or a script for tests and pictures."""

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final, Protocol

from pydantic import ValidationError

from protocol.messages import ControllerStatus, Message, PlantModel, PlantStatus, TapStatus
from protocol.topics import key_of
from runtime.inbox import Inbox
from wyner.dashboard.model import Arrival

if TYPE_CHECKING:
    from runtime.bus import Bus

WAITING_AT_MOST: Final = 32 * 2**20
"""Bytes held between two looks; what comes beyond is dropped and counted."""

MANAGEMENT_WATCHED: Final[tuple[type[Message], ...]] = (PlantModel, PlantStatus, ControllerStatus)
ADVERSARY_WATCHED: Final[tuple[type[Message], ...]] = (TapStatus,)


class Source(Protocol):
    """Gives the messages that came since it was last asked, and never waits."""

    @property
    def malformed(self) -> int:
        """Payloads that were no message of their key."""

    def drain(self) -> Sequence[Arrival]:
        """All that came since the last call, oldest first."""

    def now_ns(self) -> int:
        """The time now, of the clock that arrivals are stamped with."""

    def problems(self) -> Sequence[str]:
        """What went wrong so far, one line each, to be repeated after the screen closes."""


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
        for bus, types in (
            (management_bus, MANAGEMENT_WATCHED),
            (adversary_bus, ADVERSARY_WATCHED),
        ):
            for message_type in types:
                key = key_of(message_type, loop)
                self._types[key] = message_type
                bus.subscribe(key, self._deliver)

    def _deliver(self, key: str, payload: bytes, _sent_ns: int) -> None:
        # On a foreign thread.
        self._waiting.put((key, payload, time.monotonic_ns()), len(payload))

    @property
    def malformed(self) -> int:
        """Payloads that were no message of their key."""
        return self._malformed

    def drain(self) -> Sequence[Arrival]:
        """Parse all that is waiting; malformed is counted and left out."""
        arrivals = []
        for _ in range(len(self._waiting)):
            key, payload, t_ns = self._waiting.get(0.0)
            try:
                message = self._types[key].model_validate_json(payload)
            except (ValidationError, KeyError):
                self._malformed += 1
                continue
            arrivals.append(Arrival(t_ns, message))
        return arrivals

    def now_ns(self) -> int:
        """The monotonic clock."""
        return time.monotonic_ns()

    def problems(self) -> Sequence[str]:
        """Garbage and overflow, if there was any."""
        lines = []
        if self._malformed:
            lines.append(f"dashboard: {self._malformed} payloads were no message of their key")
        if dropped := self._waiting.dropped:
            lines.append(f"dashboard: {dropped} messages came faster than they were read")
        return lines
