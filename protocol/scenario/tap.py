"""``[tap]``: the eavesdropper's place at the field bus."""

from typing import Annotated, Literal

from pydantic import Field

from protocol.scenario.parts import NotNegative, Part


class TapView(Part):
    """What the tap sees of the field bus, and how well."""

    eavesdroppers: tuple[str, ...] = ()
    """Who listens, by name or FILE.py:CLASS; the tap's usual ones where none is named."""
    view: Literal["both", "measurements", "offers"] = "both"
    """Which of the two messages of a step she hears."""
    loss: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Probability with which she misses a message."""
    noise: NotNegative = 0.0
    """Standard deviation of the Gaussian noise on each number that she hears, in its unit."""
    quantise: NotNegative = 0.0
    """Step to which each number that she hears is rounded; 0: not at all."""
    delay: Annotated[int, Field(ge=0)] = 0
    """Steps by which she hears later."""
    model_error: NotNegative = 0.0
    """Relative error of the A and B that she is given."""
