"""From counted nonces to keys: a Cauchy matrix, any square part of which can be inverted.

If the tap missed at least as many of the counted nonces as there are rows, every row is uniform
given all that she has, exactly. No seed, no loss, and she may choose what to miss (wiretap II).

Row i and column j hold 1 / ((65535 - i) + j) in GF(2^16), where plus is exclusive or.
"""

from collections.abc import Sequence

import numpy as np

from protocol.secret.galois import ORDER, Words, inverse, product
from protocol.secret.nonces import NONCE_BYTES


def cauchy(rows: int, columns: int) -> Words:
    """The matrix, shape (rows, columns).

    Raises
    ------
    ValueError
        When rows and columns together exceed the field's 65536 elements.
    """
    if rows + columns > ORDER + 1:
        raise ValueError(
            f"rows + columns: got {rows} + {columns}, expected at most {ORDER + 1} together"
        )
    i = np.arange(ORDER, ORDER - rows, -1, dtype=np.int64).astype(np.uint16)
    j = np.arange(columns, dtype=np.int64).astype(np.uint16)
    return inverse(i[:, None] ^ j[None, :])


def words(nonces: Sequence[bytes]) -> Words:
    """Nonces of equal length as 16-bit words, big-endian, shape (nonces, length / 2)."""
    if not nonces:
        return np.zeros((0, NONCE_BYTES // 2), np.uint16)
    joined = np.frombuffer(b"".join(nonces), ">u2").astype(np.uint16)
    return joined.reshape(len(nonces), -1)


def extract(nonces: Sequence[bytes], rows: int) -> list[bytes]:
    """``rows`` rows, each as long as a nonce; column j is nonce number j.

    Parameters
    ----------
    nonces : sequence of bytes
        The counted copies, all of one even length, in an order that both ends share.
    rows : int

    Raises
    ------
    ValueError
        When there are more rows than nonces: no bound allows that.
    """
    if rows > len(nonces):
        raise ValueError(f"rows: got {rows}, expected at most the {len(nonces)} nonces counted")
    made = product(cauchy(rows, len(nonces)), words(nonces))
    return [row.tobytes() for row in made.astype(">u2")]
