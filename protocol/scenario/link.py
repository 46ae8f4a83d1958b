"""``[link]``: what the ends do when the network does not serve them."""

from typing import Annotated, Literal

from pydantic import Field

from protocol.scenario.parts import Part


class Link(Part):
    """How the loop behaves when the network does not."""

    fallback: Literal["hold", "zero"] = "hold"
    repeats_per_period: Annotated[int, Field(ge=1, le=100)] = 4
