"""Messages that are lost, as a table says it: of the network, and of the eavesdropper's place."""

from typing import Self

from pydantic import BaseModel, model_validator

from protocol.gilbert_elliott import GilbertElliott
from protocol.knowledge import Loss


class Losses(BaseModel):
    """Messages that are lost: each for itself, or in bursts (two states, Gilbert and Elliott).

    The state is the plant's step's: all messages of a step are in the same one.
    """

    loss: Loss = 0.0
    """Probability that a message is lost; with two states, in the good one."""
    loss_bad: Loss | None = None
    """Probability of a loss in the bad state; one state where not given."""
    to_bad: Loss = 0.0
    """Probability, a step, that the good state turns bad."""
    to_good: Loss = 1.0
    """Probability, a step, that the bad state turns good: bursts last 1 / to_good steps."""

    @model_validator(mode="after")
    def _two_states(self) -> Self:
        if self.loss_bad is None:
            if self.to_bad or self.to_good != 1:
                raise ValueError("expected loss_bad too where to_bad or to_good is given")
        elif self.to_bad == 0 or self.to_bad + self.to_good > 1:
            raise ValueError(
                f"got to_bad = {self.to_bad:g} and to_good = {self.to_good:g}, expected to_bad "
                "above 0 and a sum of at most 1"
            )
        return self

    @property
    def chain(self) -> GilbertElliott:
        """The losses as a chain; of one state, both states are alike."""
        if self.loss_bad is None:
            return GilbertElliott(self.loss, self.loss)
        return GilbertElliott(self.loss, self.loss_bad, self.to_bad, self.to_good)
