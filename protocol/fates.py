"""Uniform numbers by step and copy: the same message has the same fate wherever it is asked."""

from hashlib import blake2b
from typing import Final

STATE: Final = -1
"""Copy number of the draw that a step's state takes."""


class Fates:
    """Pairs of uniform numbers in [0, 1), by step and copy.

    Parameters
    ----------
    name : str
        Seed, run and direction.
    """

    def __init__(self, name: str) -> None:
        self._key = blake2b(name.encode(), digest_size=32).digest()

    def at(self, k: int, copy: int) -> tuple[float, float]:
        """The pair of a message."""
        drawn = blake2b(b"%d %d" % (k, copy), key=self._key, digest_size=16).digest()
        return _unit(drawn[:8]), _unit(drawn[8:])

    def of_step(self, k: int) -> float:
        """The number by which a step's state is found."""
        return self.at(k, STATE)[0]


def _unit(digits: bytes) -> float:
    """Eight bytes as a number in [0, 1)."""
    return (int.from_bytes(digits) >> 11) * 2.0**-53
