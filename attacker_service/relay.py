"""An attack on the field bus: between two buses, it reads and rewrites both directions.

The plant connects to one bus, the controller to the other, and nothing passes but what is passed
on here. A message that comes again is rewritten as it was before.
"""

import queue
import threading
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple, Protocol, TypeVar

from attacker_service.sieve import Sieve
from protocol.messages import FieldMessage, Measurement, Offer
from protocol.topics import key_of
from protocol.vectors import Vector
from runtime.bus import Bus
from runtime.inbox import Inbox

POLL_S: Final = 0.1

KEPT: Final = 256
"""Steps whose rewritten messages are remembered."""

T = TypeVar("T")


class _Passed(NamedTuple):
    """A message on its way."""

    kind: type[FieldMessage]
    payload: bytes


class Asked(Protocol):
    """An attack on the bus, such as :class:`attacker_service.attacker.Attacker`."""

    def candidates(self, k: int, true: Sequence[Vector]) -> tuple[Vector, ...]:
        """The candidates of step k that the plant gets."""

    def state(self, k: int, x: Vector, *, applied: bool) -> Vector:
        """The x(k) that the controller gets."""

    @property
    def sieve(self) -> Sieve:
        """What its messages go through first."""


class Rewriter:
    """The messages of one loop as an attack sends them on.

    Parameters
    ----------
    attacker : Asked
        On the bus.
    """

    def __init__(self, attacker: Asked) -> None:
        self._attacker = attacker
        self._x: dict[tuple[str, int], Vector] = {}
        self._candidates: dict[tuple[str, int], tuple[Vector, ...]] = {}

    def rewritten(self, kind: type[FieldMessage], payload: bytes) -> bytes:
        """The message as it goes on; what is none of the loop's goes on as it came."""
        message = self._attacker.sieve.read(kind, payload)
        if isinstance(message, Measurement):
            return self._measurement(message).wire()
        return payload if message is None else self._offer(message).wire()

    def _offer(self, offer: Offer) -> Offer:
        at = offer.session, offer.k
        if at not in self._candidates:
            found = self._attacker.candidates(offer.k, offer.candidates)
            _keep(self._candidates, at, found)
        return offer.model_copy(update={"candidates": self._candidates[at]})

    def _measurement(self, m: Measurement) -> Measurement:
        at = m.session, m.k
        if at not in self._x:
            applied = m.applied_k == m.k - 1
            _keep(self._x, at, self._attacker.state(m.k, m.x, applied=applied))
        after = self._x.get((m.session, m.applied_k + 1), m.x_after) if m.x_after else ()
        return m.model_copy(update={"x": self._x[at], "x_after": after})


class Relay:
    """Passes the messages of one loop on, from bus to bus.

    Parameters
    ----------
    attacker : Asked
        On the bus.
    plant, controller : Bus
        The bus on which the plant is, and that on which the controller is.
    loop : str
    """

    def __init__(self, attacker: Asked, plant: Bus, controller: Bus, loop: str) -> None:
        self._rewriter = Rewriter(attacker)
        self._inbox: Inbox[_Passed] = Inbox()
        self._put: dict[type[FieldMessage], Callable[[bytes], None]] = {
            Measurement: controller.publisher(key_of(Measurement, loop)).put,
            Offer: plant.publisher(key_of(Offer, loop)).put,
        }
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
            self._put[kind](self._rewriter.rewritten(kind, payload))


def _keep(of: dict[tuple[str, int], T], at: tuple[str, int], found: T) -> None:
    of[at] = found
    if len(of) > KEPT:
        del of[next(iter(of))]
