"""How much of a key block a tap can compute.

Of R rows from copies of which she missed e she can compute R - e combinations, as every square part
of the Cauchy matrix can be inverted: none where e is R, and no row by itself where e is not 0.
"""

from protocol.secret.nonces import NONCE_BYTES


def bits_held(rows: int, missed: int) -> int:
    """Bits that one who missed so many of a block's counted copies can compute of its rows."""
    return 8 * NONCE_BYTES * max(0, rows - missed)
