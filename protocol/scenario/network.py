"""``[network]``: what lies between the two ends, one table a direction."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from protocol.knowledge import NotNegative
from protocol.losses import Losses
from protocol.scenario.parts import ScenarioTable

LONG: float = 6.0
"""Standard deviations beyond its mean that a gamma delay is allowed for."""

WIDEST: float = 1000.0
"""Mean over deviation of a gamma delay, and its inverse, at most."""


class ChannelTable(Losses, ScenarioTable):
    """One direction: each message is lost or comes late, by draws of its own.

    Times are seconds of the plant's clock: at ``--pace x10`` all pass ten times as fast. In
    lock-step, ``--pace fast``, a step waits for its offer, and none is missed.
    """

    delay: Literal["constant", "uniform", "gamma"] = "constant"
    """How a delay is drawn: always delay_s; ``uniform``, delay_s plus or minus jitter_s at most;
    ``gamma`` of this mean and deviation."""
    delay_s: NotNegative = 0.0
    """The delay, or its mean."""
    jitter_s: NotNegative = 0.0
    """Half the width of ``uniform``, standard deviation of ``gamma``."""
    reordering: bool = True
    """Whether a message may overtake another; else it waits for those before it."""

    @model_validator(mode="after")
    def _delays_fit(self) -> Self:
        if self.delay == "constant" and self.jitter_s:
            raise ValueError(
                f"jitter_s: got {self.jitter_s:g}, expected delay = 'uniform' or 'gamma' with it"
            )
        if self.delay == "uniform" and self.jitter_s > self.delay_s:
            raise ValueError(
                f"jitter_s: got {self.jitter_s:g}, expected at most delay_s, {self.delay_s:g}"
            )
        if self.delay == "gamma" and not (self.delay_s and self.jitter_s):
            raise ValueError("delay_s and jitter_s: expected both above 0 where delay is 'gamma'")
        if self.delay == "gamma" and not 1 / WIDEST <= self.jitter_s / self.delay_s <= WIDEST:
            raise ValueError(
                f"jitter_s: got {self.jitter_s:g}, expected from delay_s / {WIDEST:g} "
                f"to {WIDEST:g} delay_s, {self.delay_s:g}"
            )
        return self

    @property
    def longest_s(self) -> float:
        """Seconds within which all but a very rare message has come."""
        return self.delay_s + (LONG if self.delay == "gamma" else 1.0) * self.jitter_s


class Network(ScenarioTable):
    """What lies between the two ends. It acts where a message of a step arrives.

    Its draws belong to (direction, step, copy): the same in a simulation, in the engine and live.
    The eavesdropper's own way is `[tap]`.
    """

    to_plant: ChannelTable = ChannelTable()
    """The way of the offers."""
    to_controller: ChannelTable = ChannelTable()
    """The way of the measurements."""
    seed: Annotated[int, Field(ge=0)] = 1
    """Of the network's draws, which are no secret; beside a run's own seed where it has one."""
