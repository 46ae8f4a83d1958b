"""An attack where it stands: at the plant's sensor or actuator, or between the two field buses.

It runs in the process that hosts it, with that process's rights: a user's attack is trusted code.
One that raises, or answers nonsense, is over, and from then on the truth passes.
"""

from collections import deque
from collections.abc import Callable, Sequence
from math import isfinite
from typing import Any, Final

import numpy as np

from attacker_service.attacks import named
from attacker_service.base import (
    UNKNOWN,
    ActuatorAttack,
    AttackError,
    BusAttack,
    LoopModel,
    Observation,
    SensorAttack,
)
from attacker_service.holdings import Coins, Offers
from attacker_service.sieve import Sieve
from protocol.arrays import Array
from protocol.link.events import AttackBegan
from protocol.link.filters import Filter
from protocol.messages import FieldMessage, Measurement, Offer
from protocol.scenario import AttackTable, Scenario
from protocol.vectors import Vector
from runtime.errors import UsageError
from runtime.logs import logger

HEARD: Final = 4096
"""Messages that may wait for Eve; the oldest go first."""

KEPT: Final = 512
"""Messages of the bus of which Eve remembers how they were rewritten."""


class Attacker(Filter):
    """An attack, with the messages and keys that it holds; a filter where it is at the plant.

    Parameters
    ----------
    scenario : Scenario
    attack : AttackTable
    seed : int, optional
        Of its draws; the operating system's if not given.

    Attributes
    ----------
    at : str
        Where it stands.
    began : AttackBegan
        Every parameter, as it is traced.
    failed : str
        Why it is over; empty while it is not.
    sieve : Sieve
        Through which its messages go first: junk on the bus costs it nothing.

    Raises
    ------
    UsageError
        With one line, when there is no such attack, or it cannot do with what it is given.
    """

    acts = listens = True

    def __init__(self, scenario: Scenario, attack: AttackTable, seed: int | None) -> None:
        if scenario.plant.C is not None:
            raise UsageError("attack: expected none beside plant.C: attacks know whole states only")
        self.failed = self._untold = ""
        self._heard: deque[tuple[type[FieldMessage], bytes]] = deque(maxlen=HEARD)
        self._rewritten: dict[tuple[type[FieldMessage], str, int], tuple[Vector, ...]] = {}
        self.sieve = Sieve(scenario)
        self._onset = attack.onset
        try:
            self._make(scenario, attack, np.random.default_rng(seed))
        except AttackError as error:
            raise UsageError(str(error)) from None
        except Exception as error:
            raise UsageError(f"attack.kind: {attack.kind}: {_line_of(error)}") from error
        self.began = AttackBegan(
            {
                "kind": attack.kind,
                "at": self.at,
                "onset": attack.onset,
                "knows": attack.knows,
                "options": self._attack.options.model_dump(mode="json"),
            }
        )

    def _make(self, scenario: Scenario, attack: AttackTable, rng: np.random.Generator) -> None:
        kind, knows = named(attack.kind), frozenset(attack.knows)
        if attack.at not in (None, kind.at):
            raise AttackError(f"attack.at: got {attack.at!r}, expected {kind.at!r}: {kind.name}")
        if lacking := sorted(kind.knows - knows):
            needs = " and ".join(map(repr, lacking))
            raise AttackError(f"attack.knows: {kind.name} needs {needs}")
        if kind.at == "bus" and scenario.defender.model is not None:
            raise AttackError(
                f"attack.kind: {kind.name} expects a linear f_c: offers carry no more"
            )
        model = LoopModel.of(scenario) if "model" in knows else None
        self._attack = kind(model, attack.options, rng)
        self.at = kind.at
        self._noise = np.random.default_rng(rng.integers(2**63))
        self._shown: Array | None = None
        self._offers = Offers() if "bus" in knows else None
        self._coins: Coins | None = None
        if {"bus", "coins"} <= knows:
            view = scenario.tap.model_dump(exclude={"eavesdroppers"})
            self._coins = Coins(scenario.knowledge(), view)

    # --- the sensor and the actuator --------------------------------------------------------------

    def sensor(self, k: int, x: Vector, y: Vector) -> Vector:  # noqa: ARG002
        """What is reported as x(k) in place of the reading ``y``, shape (n,)."""
        for _ in range(len(self._heard)):
            self._hear(k, *self._heard.popleft())
        attack, true = self._attack, np.asarray(y)
        if not isinstance(attack, SensorAttack):
            return y

        def report() -> Array:
            if k < self._onset:
                attack.watch(true)
                return true
            shown = self._shown if self._shown is not None else true
            return np.asarray(attack.sensor(self._observation(attack, k, true, shown)), float)

        (reported,) = self._checked(k, [y], lambda: [report()])
        self._shown = np.asarray(reported)
        return reported

    def actuator(self, k: int, u: Vector) -> Vector:
        """What is applied in place of the input that was chosen in step k, shape (m,)."""
        attack, chosen = self._attack, np.asarray(u)
        if not isinstance(attack, ActuatorAttack):
            return u

        def apply() -> Array:
            if k < self._onset:
                attack.watch_input(chosen)
                return chosen
            return np.asarray(attack.actuator(chosen), float)

        return self._checked(k, [u], lambda: [apply()])[0]

    def fault(self) -> str:
        """Why it is over, once."""
        told, self._untold = self._untold, ""
        return told

    def _hear(self, k: int, kind: type[FieldMessage], payload: bytes) -> None:
        if self._offers is None or self.failed:
            return
        message = self.sieve.beside_the_plant(kind, payload)
        if message is None:
            return
        self._offers.hear(message)
        if self._coins is not None:
            try:
                self._coins.hear(message)
            except Exception as error:  # of Eve's: it stops no plant
                self._over(k, _line_of(error))

    def _observation(self, attack: SensorAttack, k: int, true: Array, shown: Array) -> Observation:
        offer = None if self._offers is None else self._offers.at(k - 1)
        sees, coins = attack.options.sees, self._coins
        return Observation(
            k=k,
            shown=shown,
            candidates=None if offer is None else np.asarray(offer.candidates),
            coins=np.asarray(UNKNOWN if coins is None or offer is None else coins.of(offer)),
            seen=None if sees is None else true + sees * self._noise.standard_normal(true.shape),
        )

    # --- the bus ----------------------------------------------------------------------------------

    def incoming(self, kind: type[FieldMessage], payload: bytes) -> bytes:
        """A message of the field bus as it goes on; beside the plant it is heard, and goes on.

        One that comes again is rewritten as it was before; what is none of the loop's goes on as it
        came.
        """
        if self.at != "bus":
            self._heard.append((kind, payload))  # until the next reading is reported
            return payload
        message = self.sieve.read(kind, payload)
        if isinstance(message, Measurement):
            return self._measurement(message).wire()
        return payload if message is None else self._offer(message).wire()

    outgoing = incoming

    def _offer(self, offer: Offer) -> Offer:
        """The offer that the plant gets."""

        def rewritten(attack: BusAttack) -> Any:
            return attack.toward_plant(offer.k, np.asarray(offer.candidates))

        found = self._sent_on(offer, offer.candidates, rewritten)
        return offer.model_copy(update={"candidates": found})

    def _measurement(self, m: Measurement) -> Measurement:
        """The measurement that the controller gets."""
        applied = np.asarray(m.applied_k == m.k - 1)

        def rewritten(attack: BusAttack) -> Any:
            return [attack.toward_controller(m.k, np.asarray(m.x), applied)]

        (x,) = self._sent_on(m, (m.x,), rewritten)
        before = self._rewritten.get((Measurement, m.session, m.applied_k + 1), (m.x_after,))
        return m.model_copy(update={"x": x, "x_after": before[0] if m.x_after else ()})

    def _sent_on(
        self,
        message: FieldMessage,
        true: Sequence[Vector],
        rewritten: Callable[[BusAttack], Any],
    ) -> tuple[Vector, ...]:
        """What a message says in place of ``true``, once and for all."""
        attack, k = self._attack, message.k
        at = type(message), message.session, k
        if at not in self._rewritten:
            found = tuple(true)
            if k >= self._onset and isinstance(attack, BusAttack):
                found = self._checked(k, true, lambda: rewritten(attack))
            self._rewritten[at] = found
            if len(self._rewritten) > KEPT:
                del self._rewritten[next(iter(self._rewritten))]
        return self._rewritten[at]

    # --- what it answers --------------------------------------------------------------------------

    def _checked(
        self, k: int, true: Sequence[Vector], answer: Callable[[], Any]
    ) -> tuple[Vector, ...]:
        """The answer as rows as long as the true ones, or the true ones where it is none."""
        if self.failed:
            return tuple(true)
        try:
            rows = answer()
        except Exception as error:
            self._over(k, _line_of(error))
            return tuple(true)
        try:
            rows = [np.asarray(row, float).tolist() for row in rows]
            found = tuple([tuple([float(v) for v in row]) for row in rows])
        except (TypeError, ValueError):
            found = ()
        if [len(row) for row in found] != [len(row) for row in true] or not all(
            isfinite(v) for row in found for v in row
        ):
            shape = " and ".join(str(len(row)) for row in true)
            self._over(k, f"got {rows!r:.60}, expected {shape} finite numbers")
            return tuple(true)
        return found

    def _over(self, k: int, why: str) -> None:
        self.failed = self._untold = " ".join(why.split())
        log = logger("attacker")
        log.error("attack: %s; from step %d on the truth passes", self.failed, k)


def _line_of(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())
