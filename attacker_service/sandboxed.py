"""An attack in a process of its own (:mod:`runtime.sandbox`), beside what she holds.

The plant asks it for a reading or an input, the bus for a message. What an attack says before its
onset is the truth.
"""

from typing import Any

import numpy as np

from attacker_service import LACKS
from attacker_service.attacks import named
from attacker_service.base import (
    UNKNOWN,
    ActuatorAttack,
    Attack,
    AttackError,
    BusAttack,
    Model,
    Observation,
    SensorAttack,
)
from attacker_service.holdings import TYPES, Coins, Offers
from protocol.arrays import Array
from protocol.knowledge import Knowledge
from runtime.sandbox import serve


class AttackServer:
    """The attack, once it was made."""

    def __init__(self) -> None:
        self._attack: Attack | None = None

    def answer(self, what: str, argument: Any) -> object:
        """What the attack says when it is asked."""
        if what == "make":
            return self._make(argument)
        attack = self._attack
        if what == "reading":
            assert isinstance(attack, SensorAttack)
            return self._reading(attack, *argument)
        if what == "input":
            assert isinstance(attack, ActuatorAttack)
            return self._input(attack, *argument)
        assert isinstance(attack, BusAttack)
        return self._message(attack, what, *argument)

    def _make(self, brief: dict[str, Any]) -> object:
        kind, knows = named(brief["kind"]), frozenset(brief["knows"])
        if brief["at"] not in (None, kind.at):
            raise AttackError(f"attack.at: got {brief['at']!r}, expected {kind.at!r}: {kind.name}")
        lacking = sorted(kind.knows - knows)
        if lacking:
            needs = " and ".join(map(repr, lacking))
            raise AttackError(f"attack.knows: {kind.name} needs {needs}")
        if kind.at == "bus" and not brief["linear"]:
            raise AttackError(
                f"attack.kind: {kind.name} expects a linear f_c: offers carry no more"
            )
        rng = np.random.default_rng(brief["seed"])
        model = None
        if "model" in knows:
            model = Model(*(np.asarray(part, float) for part in brief["model"]))
        self._attack = attack = kind(model, brief["options"], rng)
        self._onset = brief["onset"]
        self._noise = np.random.default_rng(rng.integers(2**63))
        self._shown: Array | None = None
        self._offers = Offers() if "bus" in knows else None
        self._coins = None
        if {"bus", "coins"} <= knows:
            knowledge = Knowledge.model_validate_json(brief["knowledge"])
            self._coins = Coins(knowledge, brief["view"])
        options = attack.options.model_dump(mode="json")
        return {"at": kind.at, "name": kind.name, "options": options}

    # --- the sensor -------------------------------------------------------------------------------

    def _reading(
        self, attack: SensorAttack, k: int, x: tuple[float, ...], heard: tuple[Any, ...]
    ) -> object:
        for topic, payload in heard:
            message = TYPES[topic].model_validate_json(payload)
            if self._offers is not None:
                self._offers.hear(message)
            if self._coins is not None:
                self._coins.hear(message)
        true = np.asarray(x)
        if k < self._onset:
            attack.watch(true)
            self._shown = true
            return x
        shown = self._shown if self._shown is not None else true
        self._shown = np.asarray(attack.sensor(self._told(attack, k, true, shown)), float)
        return self._shown.tolist()

    def _told(self, attack: SensorAttack, k: int, true: Array, shown: Array) -> Observation:
        offer = None if self._offers is None else self._offers.at(k - 1)
        sees, coins = attack.options.sees, self._coins
        return Observation(
            k=k,
            shown=shown,
            candidates=None if offer is None else np.asarray(offer.candidates),
            coins=np.asarray(UNKNOWN if coins is None or offer is None else coins.of(offer)),
            seen=None if sees is None else true + sees * self._noise.standard_normal(true.shape),
        )

    # --- the actuator -----------------------------------------------------------------------------

    def _input(
        self, attack: ActuatorAttack, k: int, u: tuple[float, ...], _heard: tuple[Any, ...]
    ) -> object:
        chosen = np.asarray(u)
        if k < self._onset:
            attack.watch_input(chosen)
            return u
        return np.asarray(attack.actuator(chosen), float).tolist()

    # --- the bus ----------------------------------------------------------------------------------

    def _message(
        self, attack: BusAttack, what: str, k: int, true: Any, beside: tuple[bool, ...]
    ) -> object:
        if k < self._onset:
            return true
        if what == "offer":
            return np.asarray(attack.toward_plant(k, np.asarray(true)), float).tolist()
        (applied,) = beside
        rewritten = attack.toward_controller(k, np.asarray(true), np.asarray(applied))
        return np.asarray(rewritten, float).tolist()


if __name__ == "__main__":
    serve(AttackServer().answer, ((AttackError, LACKS),))
