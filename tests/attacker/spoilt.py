"""Attacks of a user's own, good and bad: each a class in one file."""

from typing import ClassVar

import numpy as np

from attacker_service.base import Observation, SensorAttack
from protocol.arrays import Array


class Frozen(SensorAttack):
    """Toy: says for ever what it said last."""

    name: ClassVar[str] = "frozen"

    def sensor(self, observed: Observation) -> Array:
        return observed.shown


class Raises(SensorAttack):
    name: ClassVar[str] = "raises"

    def sensor(self, observed: Observation) -> Array:
        raise RuntimeError("out of\nideas")


class Short(SensorAttack):
    name: ClassVar[str] = "short"

    def sensor(self, observed: Observation) -> Array:
        return observed.shown[:1]


class Nan(SensorAttack):
    name: ClassVar[str] = "nan"

    def sensor(self, observed: Observation) -> Array:
        return observed.shown * np.nan
