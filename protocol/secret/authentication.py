"""One-time tags: a polynomial modulo 2^127 - 1 at a secret point, under a pad used once.

A message of w words is forged with probability (w + 1) / (2^127 - 1) at most, whatever the forger
can compute (Wegman and Carter 1981; den Boer 1993). The point may stay, the pad may not. Two tags
whose pads and texts are known are two equations for one point, so it does not stay for long either:
:mod:`runtime.keys.ledger` renews it.
"""

from typing import Final, NamedTuple

PRIME: Final = 2**127 - 1
TAG_BYTES: Final = 16
WORD_BYTES: Final = 15
"""A word is below 2^120 and so below the prime, whatever its bytes are."""

RESERVE: Final = 16
"""Sets of pads in a first secret: each session takes one for its first key block."""

PADS_BYTES: Final = 3 * TAG_BYTES
"""A set: the point, the pad of the controller's tag, that of the plant's."""

SECRET_BYTES: Final = RESERVE * PADS_BYTES


def polynomial(point: int, data: bytes) -> int:
    """The words of ``data`` and its length as coefficients, evaluated at ``point``.

    w_1 z^(m+1) + ... + w_m z^2 + length z modulo 2^127 - 1: no two texts share their coefficients,
    and no constant term remains that a forger could move along with the pad.
    """
    total = 0
    for start in range(0, len(data), WORD_BYTES):
        total = (total + int.from_bytes(data[start : start + WORD_BYTES])) * point % PRIME
    return (total + len(data)) * point % PRIME


def number(raw: bytes) -> int:
    """16 uniform bytes as a number modulo the prime: the top bit is left out."""
    return int.from_bytes(raw) & PRIME


def under(pad: int, value: int) -> str:
    """A polynomial's value under its pad: the tag, 32 hexadecimal digits."""
    return f"{(value + pad) % PRIME:032x}"


def tag(point: int, pad: int, data: bytes) -> str:
    """The tag of ``data``."""
    return under(pad, polynomial(point, data))


class Secret(NamedTuple):
    """What the two ends share before the first block: sets of pads.

    ``name`` says in logs and ledgers which secret it is; it is public and random.
    """

    name: str
    sets: tuple[bytes, ...]
