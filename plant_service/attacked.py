"""A plant whose sensor or actuator is attacked: the attack stands between plant and service."""

from collections import deque
from typing import TYPE_CHECKING, Final, Self

from plant_service.plant import Plant
from protocol.link.session import Truth
from protocol.messages import FIELD
from protocol.topics import key_of
from protocol.vectors import Vector
from runtime.bus import Bus, Channel, Publisher

if TYPE_CHECKING:
    from attacker_service.attacker import Attacker

Heard = deque[tuple[str, bytes]]
"""Topics and payloads of messages that were heard."""

HEARD: Final = 4096
"""Messages that may wait for her; the oldest go first."""


class AttackedPlant:
    """The plant as its service sees it: its truth stands apart, in :attr:`truth`.

    A step acts, since the truth is in no journal: a process that died begins anew where the plant
    is started.

    Parameters
    ----------
    plant : Plant
    attacker : Attacker
        At the sensor or at the actuator.
    x : tuple of float, shape (n,)
        Where the plant stands.
    """

    acts = True

    def __init__(self, plant: Plant, attacker: "Attacker", x: Vector) -> None:
        self._plant = plant
        self.attacker = attacker
        self.device = plant.device
        self.truth: Truth | None = None
        self._x = x
        self._u: Vector = ()
        self._told = ""
        self.heard: Heard = deque(maxlen=HEARD)

    def prepare(self, k: int) -> None:
        """As the plant."""
        self._plant.prepare(k)

    def begin(self, k: int, x: Vector, u: Vector) -> None:  # noqa: ARG002
        """Apply ``u``, or what an attack on the actuator makes of it, where the plant stands."""
        at_actuator = self.attacker.at == "actuator"
        self._u = self.attacker.input(k, u) if at_actuator else u
        self._plant.begin(k, self._x, self._u)

    def end(self, k: int) -> Vector:
        """x(k+1) as it is reported; the true one is in :attr:`truth`."""
        self._x = reported = self._plant.end(k)
        if self.attacker.at == "sensor":
            heard = [self.heard.popleft() for _ in range(len(self.heard))]
            reported = self.attacker.reading(k + 1, self._x, heard)
        failed = "" if self._told else self.attacker.failed
        self._told = self.attacker.failed
        inner = self._plant.truth  # of noisy sensors
        self.truth = Truth(self._x if inner is None else inner.x_next, self._u, failed)
        return reported

    def safe(self, why: str) -> None:
        """As the plant."""
        self._plant.safe(why)

    def close(self) -> str:
        """As the plant."""
        self.attacker.sieve.tell()
        return self._plant.close()

    def overheard(self, bus: Bus, loop: str) -> Bus:
        """The field bus, of which every message that passes here is heard by her, too."""
        return _Overheard(bus, self.heard, {key_of(kind, loop): kind.topic for kind in FIELD})


class _Overheard:
    """A bus whose messages on some keys are noted as they pass."""

    def __init__(self, bus: Bus, heard: Heard, topics: dict[str, str]) -> None:
        self._bus, self._heard, self._topics = bus, heard, topics
        self.subscribe, self.appearances = bus.subscribe, bus.appearances
        self.left, self.close = bus.left, bus.close

    def publisher(self, key: str, *, many: bool = False) -> Publisher:
        publisher = self._bus.publisher(key, many=many)
        topic = self._topics.get(key)
        return publisher if topic is None else _Noted(publisher, self._heard, topic)

    def channel(self, key_expr: str, capacity: int) -> Channel:
        channel = self._bus.channel(key_expr, capacity)
        return _NotedChannel(channel, self._heard, self._topics)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class _Noted:
    """A publisher whose messages are noted."""

    def __init__(self, publisher: Publisher, heard: Heard, topic: str) -> None:
        self._put, self._heard, self._topic = publisher.put, heard, topic

    def put(self, payload: bytes) -> None:
        self._heard.append((self._topic, payload))
        self._put(payload)


class _NotedChannel:
    """A channel whose messages are noted."""

    def __init__(self, channel: Channel, heard: Heard, topics: dict[str, str]) -> None:
        self._receive, self.close = channel.receive, channel.close
        self._heard, self._topics = heard, topics

    def receive(self, *, wait: bool) -> list[tuple[str, bytes]]:
        taken = self._receive(wait=wait)
        self._heard += [(self._topics[k], payload) for k, payload in taken if k in self._topics]
        return taken
