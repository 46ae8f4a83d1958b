"""The schemes by name, as a scenario's ``[secrecy] scheme`` gives it."""

from typing import Any, Final

from protocol.registry import Classes
from protocol.schemes.base import Scheme

SCHEMES: Final[Classes[Scheme[Any]]] = Classes(
    "scheme",
    Scheme,
    {
        "switched": "protocol.schemes.switched:Switched",
        "pipelined": "protocol.schemes.pipelined:Pipelined",
    },
)


def make_scheme(name: str, alphabet: int) -> Scheme[Any]:
    """The scheme of that name over ``alphabet`` symbols.

    Raises
    ------
    protocol.registry.UnknownError
        When there is none.
    """
    return SCHEMES[name](alphabet)
