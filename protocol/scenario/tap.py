"""``[tap]``: the eavesdropper's place at the field bus."""

from protocol.knowledge import Delay, Direction, NotNegative
from protocol.losses import Losses
from protocol.scenario.parts import ScenarioTable


class TapView(Losses, ScenarioTable):
    """What the tap sees of the field bus, and how well: a way of its own, beside the loop's."""

    eavesdroppers: tuple[str, ...] = ()
    """Who listens, by name or FILE.py:CLASS; the tap's usual ones where none is named."""
    view: Direction = "both"
    """Which of the two messages of a step Eve hears."""
    noise: NotNegative = 0.0
    """Standard deviation of the Gaussian noise on each number that Eve hears, in its unit."""
    quantise: NotNegative = 0.0
    """Step to which each number that Eve hears is rounded; 0: not at all."""
    delay: Delay = 0
    """Messages by which everything reaches Eve late."""
    model_error: NotNegative = 0.0
    """Relative error of the A and B that Eve is given."""
