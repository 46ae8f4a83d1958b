"""Nonces and copies: what of a step counts, and when a message may carry a nonce that does.

Of each message of a step the first copy, copy 0, may count, and it leaves at most once. Everything
after it is copy 1 with a nonce drawn afresh and thrown away: a copy that were repeated with its
nonce would give a tap a second chance to hear it. A process that cannot be sure whether its copy 0
left sends copy 1: that costs a symbol, and never a secret.

Each end names the copy that it took of the other's message (``heard`` in an offer,
``applied_copy`` in a measurement). A nonce belongs to a transition, and both ends count transitions
exactly once; so both know the same nonces without another word.
"""

import secrets
from binascii import a2b_base64, b2a_base64
from collections.abc import Callable
from typing import Final, Literal, NamedTuple

Copy = Literal[0, 1]

NONCE_BYTES: Final = 32
"""w = 256 bits: a copy that she misses makes one row of key, and a row is one key of 256 bits."""

FIRST: Final = 0
"""The number of the copy that may count; all others are copies 1."""

NONCE_FORM: Final = rf"^([A-Za-z0-9+/]{{{-(-NONCE_BYTES // 3) * 4 - 1}}}=)?$"
"""A nonce in base64, or nothing where the scenario makes no keys."""

NonceSource = Callable[[], str]


def fresh_nonce() -> str:
    """A nonce from the operating system's generator, in base64."""
    return b2a_base64(secrets.token_bytes(NONCE_BYTES), newline=False).decode()


def as_bytes(nonce: str) -> bytes:
    """The nonce itself."""
    return a2b_base64(nonce)


class Contribution(NamedTuple):
    """What one counted transition contributes, as both ends know it.

    ``j`` is its number in the session and ``steps`` how many steps it came after the transition
    before; ``offer`` and ``measurement`` are the nonces of its two copies 0, None where the copy
    that was taken was another.
    """

    j: int
    steps: int
    offer: bytes | None
    measurement: bytes | None

    @property
    def counts(self) -> int:
        """Which copies count: 0 none, 1 the offer's, 2 the measurement's, 3 both."""
        return (self.offer is not None) + 2 * (self.measurement is not None)


def contribution_of(
    *, j: int, steps: int, offer: str, applied_copy: int, measurement: str, heard: int
) -> Contribution:
    """The raw row of transition ``j``.

    Parameters
    ----------
    j, steps : int
    offer : str
        Nonce of the offer's copy 0.
    applied_copy : int
        The copy of the offer that was applied.
    measurement : str
        Nonce of copy 0 of the measurement that the offer answers.
    heard : int
        The copy of that measurement which the controller heard first.
    """
    return Contribution(
        j,
        steps,
        as_bytes(offer) if offer and applied_copy == FIRST else None,
        as_bytes(measurement) if measurement and heard == FIRST else None,
    )
