"""`bias`: the limit. Eve sees the plant as it is, and says that D_c did less than it does."""

from typing import Annotated, ClassVar

from pydantic import Field

from attacker_service.attacks.ghost import Ghost


class Bias(Ghost):
    """A ghost that tells the coin from the plant itself, so that no key helps against Eve.

    The actuator is honest, the report is one that an honest plant could have made, and the
    controller, which steers the report, lets the true state drift by d - d' a step.
    """

    class Options(Ghost.Options):
        """``sees`` is exact."""

        sees: Annotated[float | None, Field(ge=0, le=0)] = 0.0
        share: Annotated[float, Field(ge=0, le=1)] = 0.0

    name: ClassVar[str] = "bias"
    options: Options
