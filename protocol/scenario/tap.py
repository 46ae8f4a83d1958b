"""``[tap]``: the eavesdropper's place at the field bus."""

from typing import Annotated, Literal

from pydantic import Field

from protocol.scenario.parts import NotNegative, Part


class TapView(Part):
    """What the tap sees of the field bus, and how well."""

    eavesdroppers: tuple[str, ...] = ()
    view: Literal["both", "measurements", "offers"] = "both"
    loss: Annotated[float, Field(ge=0, le=1)] = 0.0
    noise: NotNegative = 0.0
    quantise: NotNegative = 0.0
    delay: Annotated[int, Field(ge=0)] = 0
    model_error: NotNegative = 0.0
