"""`bias`: the limit. She sees the plant as it is, and says that D_c did less than it does."""

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from attacker_service.attacks.ghost import Ghost
from attacker_service.base import AttackError
from protocol.arrays import Array


class Bias(Ghost):
    """A ghost whose own disturbance is one constant within D_c, while the true plant drifts away.

    She tells the coin from the plant itself, so no key helps against her: the actuator is honest,
    the report is one that an honest plant could have made, and the controller, which steers the
    report, lets the true state drift by d - d' a step.
    """

    class Options(Ghost.Options):
        """``sees`` is exact; ``direction`` of the constant: all states alike where none is given.

        ``share`` of D_c is how large it is.
        """

        sees: Annotated[float | None, Field(ge=0, le=0)] = 0.0
        share: Annotated[float, Field(ge=0, le=1)] = 0.9
        direction: tuple[float, ...] = ()

    name: ClassVar[str] = "bias"
    options: Options

    def _disturbance(self, shape: tuple[int, ...]) -> Array:
        way = np.asarray(self.options.direction or (1.0,) * shape[-1])
        if way.shape != shape[-1:] or not way.any():
            raise AttackError(
                f"attack.direction: got {way.tolist()}, expected {shape[-1]} numbers, one not zero"
            )
        return np.broadcast_to(self.options.share * way / self.model.gauge(way), shape)
