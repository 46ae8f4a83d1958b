"""``[secrecy]``: the agreement rule."""

from typing import Annotated

from pydantic import Field

from protocol.scenario.parts import Part


class Secrecy(Part):
    """The agreement rule's public-by-assumption half: D_e = alpha D_c, and M candidates."""

    alpha: Annotated[float, Field(ge=1, allow_inf_nan=False)]
    """D_e = alpha D_c, her set; 1: she knows what the ends know."""
    candidates: Annotated[int, Field(ge=2, le=256)] = 2
    """M, inputs in an offer; a key symbol is one of M."""
