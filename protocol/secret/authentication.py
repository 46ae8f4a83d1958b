"""One-time tags: a polynomial modulo 2^127 - 1 at a secret point, under a pad used once.

A message of w words is forged with probability (w + 1) / (2^127 - 1) at most, whatever the forger
can compute (Wegman and Carter 1981; den Boer 1993). A pad serves one tag. A point may serve
several, but two tags whose pads and texts are known give two equations for it, so
:mod:`runtime.keys.ledger` renews it.
"""

from typing import Final, NamedTuple

PRIME: Final = 2**127 - 1
TAG_BYTES: Final = 16
WORD_BYTES: Final = 15
"""Bytes of a word. It is below 2^120, and so below the prime."""

RESERVE: Final = 16
"""Sets of pads in a first secret: each session takes one for its first key block."""

PADS_BYTES: Final = 3 * TAG_BYTES
"""Bytes of a set: the point, the pad of the controller's tag, the pad of the plant's."""

SECRET_BYTES: Final = RESERVE * PADS_BYTES


def polynomial(point: int, data: bytes) -> int:
    """A polynomial with the words and the length of ``data`` as coefficients, at ``point``.

    w_1 z^(m+1) + ... + w_m z^2 + length z modulo 2^127 - 1. No two texts share their coefficients.
    There is no constant term, which a forger could shift together with the pad.
    """
    total = 0
    for start in range(0, len(data), WORD_BYTES):
        total = (total + int.from_bytes(data[start : start + WORD_BYTES])) * point % PRIME
    return (total + len(data)) * point % PRIME


def number(raw: bytes) -> int:
    """16 uniform bytes as a number of 127 bits; the top bit is dropped."""
    return int.from_bytes(raw) & PRIME


def under(pad: int, value: int) -> str:
    """A polynomial's value under its pad: the tag, 32 hexadecimal digits."""
    return f"{(value + pad) % PRIME:032x}"


def tag(point: int, pad: int, data: bytes) -> str:
    """The tag of ``data``."""
    return under(pad, polynomial(point, data))


class Secret(NamedTuple):
    """What the two ends share before the first block: sets of pads.

    ``name`` is random and public; logs and ledgers name the secret by it.
    """

    name: str
    sets: tuple[bytes, ...]
