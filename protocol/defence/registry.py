"""The defences that are shipped, by name, and how one of a user's own is found."""

from typing import Final

from protocol.defence.base import Defence
from protocol.registry import Classes

DEFENCES: Final[Classes[Defence]] = Classes(
    "defence",
    Defence,
    {
        "residual": "protocol.defence.residual:Residual",
        "keyed-coin": "protocol.defence.keyed_coin:KeyedCoin",
        "coding": "protocol.defence.coding:Coding",
        "static-coding": "protocol.defence.coding:StaticCoding",
        "mac": "protocol.defence.mac:Mac",
    },
)


def make_defence(name: str, states: int, candidates: int) -> Defence:
    """The defence of this name, or of ``path/to/file.py:Name``.

    Raises
    ------
    UnknownError
        In one line, when there is none, or it is no defence.
    """
    return DEFENCES[name](states, candidates)
