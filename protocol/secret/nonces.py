"""Nonces and copies: which nonces of a step count.

The first copy of a step's message is copy 0. Its nonce may count, and it leaves at most once. Every
later copy is copy 1, with a nonce drawn afresh and thrown away: a repeated nonce would give the tap
a second chance. A process that cannot be sure whether its copy 0 left sends copy 1. That costs a
nonce, and never a secret.

Each end names the copy that it took of the other's message (``heard`` in an offer,
``applied_copy`` in a measurement). Both count each transition exactly once, so both know which
nonces count.
"""

from binascii import a2b_base64
from collections.abc import Callable
from typing import Final, Literal, NamedTuple

Copy = Literal[0, 1]

NONCE_BYTES: Final = 32
"""256 bits. A copy that Eve misses makes one row, and a row is one key of 256 bits."""

FIRST: Final = 0
"""Number of the copy that may count."""

NONCE_FORM: Final = rf"^([A-Za-z0-9+/]{{{-(-NONCE_BYTES // 3) * 4 - 1}}}=)?$"
"""A nonce in base64; empty where the scenario makes no keys."""

NonceSource = Callable[[], str]
"""Gives a fresh nonce in base64 each time (:func:`runtime.chance.fresh_nonce`)."""


def as_bytes(nonce: str) -> bytes:
    """The 32 bytes of a nonce in base64."""
    return a2b_base64(nonce)


class Contribution(NamedTuple):
    """What one counted transition contributes to its key block; both ends know the same.

    Parameters
    ----------
    j : int
        Number of the transition in the session.
    steps : int
        Steps since the transition before: 1, and 1 more for each missed step.
    offer, measurement : bytes or None
        The nonces of its two copies 0; None where another copy was taken.
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
    """The contribution of transition ``j``.

    Parameters
    ----------
    j, steps : int
        As in `Contribution`.
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
        a2b_base64(offer) if offer and applied_copy == FIRST else None,
        a2b_base64(measurement) if measurement and heard == FIRST else None,
    )
