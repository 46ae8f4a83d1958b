"""``[link]``: what the ends do when the network does not serve them."""

from typing import Annotated, Literal

from pydantic import Field

from protocol.scenario.parts import Positive, ScenarioTable


class Link(ScenarioTable):
    """How the loop behaves when the network does not.

    On a missed step the plant holds its input, applies zero, or the ``regulator``: u = K x by
    itself, clipped to U, which asks for a stated ``control.gain``.
    """

    fallback: Literal["hold", "zero", "regulator"] = "hold"
    """What the plant applies in a step without an offer."""
    watchdog_s: Positive | None = None
    """Seconds without an applied offer after which the plant goes to its safe state, for good; a
    plant that has never moved has 10 at least, to meet its controller."""
    repeats_per_period: Annotated[int, Field(ge=1, le=100)] = 4
    """How often a measurement is repeated while no offer has come."""
