"""What the plant's end steps: a plant with its coin and its receiver."""

from typing import Protocol

from plant_service.plant import Move, PlantStep
from protocol.link.receiver import Receiver
from protocol.messages import Offer


class Stepper(Protocol):
    """A plant as :class:`plant_service.plant.Plant`, or one that acts (`plant_service.device`).

    ``move`` must come to the same end when it is called again for a step that was not counted.
    """

    receiver: Receiver

    def move(self, offer: Offer) -> Move:
        """Choose one input of the current ``offer``, and apply it."""

    def count(self, move: Move) -> PlantStep:
        """Count the transition that ``move`` made."""

    def miss(self) -> PlantStep:
        """Apply the fallback input."""

    def safe(self, why: str) -> None:
        """Go to the safe state."""

    def close(self) -> str:
        """Let go of what is stepped; a line where that failed."""
