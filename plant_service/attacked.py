"""A plant whose sensor or actuator is attacked: the attack stands between plant and service.

The attack's code, and the eavesdropper whose keys it uses, run in a process of their own
(:mod:`runtime.sandbox`). Where it fails, loops or speaks nonsense the truth passes from then on,
and a line says why.
"""

from collections import deque
from collections.abc import Iterable
from math import isfinite
from typing import Any, Final, Self

from plant_service.plant import Plant
from protocol.link.events import AttackBegan
from protocol.link.session import Truth
from protocol.messages import FIELD
from protocol.scenario import Attack, Scenario
from protocol.topics import key_of
from protocol.vectors import Vector
from runtime.bus import Bus, Channel, Publisher
from runtime.errors import Failure, UsageError
from runtime.logs import logger
from runtime.sandbox import START_S, SandboxError, SandboxProcess, acquire, give_back

ANSWER_S: Final = 2.0
"""Seconds that an attack has for a step."""

HEARD: Final = 4096
"""Messages that may wait for her; the oldest go first."""

LACKS: Final = "lacks"

Heard = tuple[str, bytes]
"""A message's topic and payload."""


def brief(scenario: Scenario, attack: Attack, seed: int | None) -> dict[str, Any]:
    """What an attack is made of: numbers and names alone, for its own process.

    The eavesdropper beside it hears through the scenario's own tap channel.
    """
    rows = (*scenario.defender.disturbance.rows(), *scenario.control.inputs.rows())
    return {
        "kind": attack.kind,
        "at": attack.at,
        "onset": attack.onset,
        "knows": attack.knows,
        "options": attack.options,
        "model": (scenario.A, scenario.B, *rows),
        "knowledge": scenario.knowledge().model_dump_json(),
        "view": scenario.tap.model_dump(exclude={"eavesdroppers"}),
        "seed": seed,
    }


class Attacker:
    """An attack in its own process, made and asked.

    Parameters
    ----------
    scenario : Scenario
    attack : Attack
    seed : int, optional
        Of its draws; the operating system's if not given.

    Attributes
    ----------
    at : str
        Where it stands.
    began : AttackBegan
        Every parameter, as it is traced.

    Raises
    ------
    UsageError
        With one line, when there is no such attack, or it cannot do with what it is given.
    """

    def __init__(self, scenario: Scenario, attack: Attack, seed: int | None) -> None:
        self._process: SandboxProcess = acquire("attacker_service.sandboxed")
        try:
            made = self._process.ask("make", brief(scenario, attack, seed), START_S)
            self.at = str(made["at"])
            options = dict(made["options"])
        except SandboxError as error:
            self._process.close()
            named = error.kind == LACKS
            text = str(error) if named else f"attack.kind: {attack.kind}: {error}"
            raise UsageError(text) from None
        self.began = AttackBegan(
            {
                "kind": attack.kind,
                "at": self.at,
                "onset": attack.onset,
                "knows": attack.knows,
                "options": options,
            }
        )

    def ask(self, what: str, k: int, vector: Vector, heard: Iterable[Heard] = ()) -> Vector:
        """What it puts in place of ``vector`` in step ``k``, as long and finite.

        Raises
        ------
        Failure
            With one line, where it says nothing that could be.
        """
        told = self._process.ask(what, (k, vector, tuple(heard)), ANSWER_S)
        try:
            found = tuple([float(v) for v in told])
        except (TypeError, ValueError):
            raise Failure(f"got {told!r:.60}, expected {len(vector)} numbers") from None
        if len(found) != len(vector) or not all(map(isfinite, found)):
            raise Failure(f"got {list(found)!r:.60}, expected {len(vector)} finite numbers")
        return found

    def close(self) -> None:
        """Let go of it."""
        give_back(self._process)


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

    def __init__(self, plant: Plant, attacker: Attacker, x: Vector) -> None:
        self._plant = plant
        self._attacker = attacker
        self.device = plant.device
        self.truth: Truth | None = None
        self._x = x
        self._u: Vector = ()
        self._over = self._failed = ""
        self.heard: deque[Heard] = deque(maxlen=HEARD)

    def prepare(self, k: int) -> None:
        """As the plant."""
        self._plant.prepare(k)

    def begin(self, k: int, x: Vector, u: Vector) -> None:  # noqa: ARG002
        """Apply ``u``, or what an attack on the actuator makes of it, where the plant stands."""
        self._u = u if self._attacker.at != "actuator" else self._asked("input", k, u)
        self._plant.begin(k, self._x, self._u)

    def end(self, k: int) -> Vector:
        """x(k+1) as it is reported; the true one is in :attr:`truth`."""
        self._x = reported = self._plant.end(k)
        if self._attacker.at == "sensor":
            heard = [self.heard.popleft() for _ in range(len(self.heard))]
            reported = self._asked("reading", k + 1, self._x, heard)
        self.truth = Truth(self._x, self._u, self._failed)
        self._failed = ""
        return reported

    def _asked(self, what: str, k: int, vector: Vector, heard: Iterable[Heard] = ()) -> Vector:
        if self._over:
            return vector
        try:
            return self._attacker.ask(what, k, vector, heard)
        except Failure as error:
            self._over = self._failed = str(error)
            logger("plant").error("attack: %s; from step %d on the truth passes", error, k)
            return vector

    def safe(self, why: str) -> None:
        """As the plant."""
        self._plant.safe(why)

    def close(self) -> str:
        """Let go of the plant, and of the attack."""
        self._attacker.close()
        return self._plant.close()

    def overheard(self, bus: Bus, loop: str) -> Bus:
        """The field bus, of which every message that passes here is heard by her, too."""
        return _Overheard(bus, self.heard, {key_of(kind, loop): kind.topic for kind in FIELD})


class _Overheard:
    """A bus whose messages on some keys are noted as they pass."""

    def __init__(self, bus: Bus, heard: deque[Heard], topics: dict[str, str]) -> None:
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

    def __init__(self, publisher: Publisher, heard: deque[Heard], topic: str) -> None:
        self._put, self._heard, self._topic = publisher.put, heard, topic

    def put(self, payload: bytes) -> None:
        self._heard.append((self._topic, payload))
        self._put(payload)


class _NotedChannel:
    """A channel whose messages are noted."""

    def __init__(self, channel: Channel, heard: deque[Heard], topics: dict[str, str]) -> None:
        self._receive, self.close = channel.receive, channel.close
        self._heard, self._topics = heard, topics

    def receive(self, *, wait: bool) -> list[tuple[str, bytes]]:
        taken = self._receive(wait=wait)
        self._heard += [(self._topics[k], payload) for k, payload in taken if k in self._topics]
        return taken
