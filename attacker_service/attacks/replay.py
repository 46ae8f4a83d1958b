"""`replay`: records honest readings, and reports them again."""

from collections import deque
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from attacker_service.base import LoopModel, Observation, SensorAttack
from attacker_service.base import Options as CommonOptions
from protocol.arrays import Array


class Replay(SensorAttack):
    """The last ``length`` readings before the onset, from the oldest on, over and over."""

    class Options(CommonOptions):
        """``length``: how many readings are recorded."""

        length: Annotated[int, Field(ge=1, le=100_000)] = 50

    name: ClassVar[str] = "replay"
    options: Options

    def __init__(
        self, model: LoopModel | None, options: Mapping[str, Any], rng: np.random.Generator
    ) -> None:
        super().__init__(model, options, rng)
        self._recorded: deque[Array] = deque(maxlen=self.options.length)

    def watch(self, reading: Array) -> None:
        """Record it."""
        self._recorded.append(reading)

    def sensor(self, observed: Observation) -> Array:
        """The oldest reading, which goes behind the others; the last report where none is there."""
        if not self._recorded:
            return observed.shown
        self._recorded.rotate(-1)
        return self._recorded[-1]
