"""``[secrecy]``: the agreement rule, and the scheme over it."""

from typing import Annotated

from pydantic import Field, field_validator

from protocol.plugins import UnknownError
from protocol.scenario.parts import ScenarioTable
from protocol.scenario.sets import ConvexSet
from protocol.schemes.registry import scheme_named


class Secrecy(ScenarioTable):
    """The agreement rule's public-by-assumption half: D_e and M candidates.

    D_e is alpha D_c, or alpha times ``disturbance`` where that is given: equation (11) asks no more
    than that D_e contains D_c. ``scheme`` is one that :data:`protocol.schemes.registry.SCHEMES`
    knows, or a class of the user's, ``path/to/file.py:Name``.
    """

    alpha: Annotated[float, Field(ge=1, allow_inf_nan=False)]
    """D_e = alpha D_c, Eve's set; 1: Eve knows what the ends know."""
    disturbance: ConvexSet | None = None
    """Of another shape than D_c: D_e is alpha times this, and must contain D_c."""
    candidates: Annotated[int, Field(ge=2, le=256)] = 2
    """M, inputs in an offer; a key symbol is one of M."""
    scheme: str = "switched"
    """Which transitions agree and which carry: a shipped scheme, or ``path/to/file.py:Name``."""

    @field_validator("scheme")
    @classmethod
    def _known(cls, name: str) -> str:
        try:
            scheme_named(name)
        except UnknownError as error:
            raise ValueError(str(error).removeprefix(f"got {name!r}, ")) from None
        return name
