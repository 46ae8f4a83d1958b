"""From counted nonces to keys: a Cauchy matrix, any square part of which can be inverted.

If the tap missed at least as many counted nonces as there are rows, every row is exactly uniform
given all that Eve has. No seed is needed, and Eve may choose what to miss (wiretap channel II).

Row i and column j hold 1 / ((65535 - i) + j) in GF(2^16), where plus is exclusive or.

A column is a nonce; its 16 words are worked on side by side. If Eve hears half of each missed nonce
Eve knows half of every row. Where that may be, a column is a word of 16 bits and a key is 16 rows:
then the words that Eve missed count, wherever they are.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from protocol.secret.blocks import TAG_DIGITS, ClosedBlock, ExtractedBlock
from protocol.secret.galois import ORDER, Words, inverse, product
from protocol.secret.nonces import NONCE_BYTES

WORDS: Final = NONCE_BYTES // 2
"""Words of 16 bits in a nonce, and in a row of a block."""

SLICE: Final = 1 << 15
"""Elements of the matrix at once. They take a few hundred kilobytes, however large a block is."""


def cauchy(rows: int, columns: int, first: int = 0) -> Words:
    """The Cauchy matrix from column ``first`` on, shape (rows, columns).

    Raises
    ------
    ValueError
        When rows and columns together exceed the field's 65536 elements.
    """
    if rows + first + columns > ORDER + 1:
        raise ValueError(
            f"rows + columns: got {rows} + {first + columns}, expected at most {ORDER + 1} together"
        )
    i = np.arange(ORDER, ORDER - rows, -1, dtype=np.int64).astype(np.uint16)
    j = np.arange(first, first + columns, dtype=np.int64).astype(np.uint16)
    return inverse(i[:, None] ^ j[None, :])


def words(nonces: Sequence[bytes]) -> Words:
    """Nonces of equal length as 16-bit words, big-endian, shape (nonces, length / 2)."""
    if not nonces:
        return np.zeros((0, WORDS), np.uint16)
    joined = np.frombuffer(b"".join(nonces), ">u2").astype(np.uint16)
    return joined.reshape(len(nonces), -1)


def extract(nonces: Sequence[bytes], rows: int, by_words: bool = False) -> list[bytes]:
    """The block's rows, each as long as a nonce. Column j of the matrix is nonce, or word, j.

    Parameters
    ----------
    nonces : sequence of bytes
        Nonces that count, all of one even length, in an order that both ends share.
    rows : int
        R, the rows that the bound allows.
    by_words : bool
        A column is a word of 16 bits, and a row of the block is 16 rows of the matrix.

    Raises
    ------
    ValueError
        When there are more rows than nonces: no bound allows that.
    """
    if rows > len(nonces):
        raise ValueError(f"rows: got {rows}, expected at most the {len(nonces)} nonces counted")
    x = words(nonces)
    shape = rows, x.shape[1]
    if by_words:
        x = x.reshape(-1, 1)
    out = np.zeros((shape[0] * shape[1] // x.shape[1], x.shape[1]), np.uint16)
    step = max(1, SLICE // max(1, len(out)))
    for j in range(0, len(x), step):
        part = x[j : j + step]
        out ^= product(cauchy(len(out), len(part), j), part)
    return [row.tobytes() for row in out.reshape(shape).astype(">u2")]


def extracted(block: ClosedBlock) -> ExtractedBlock:
    """The tag and the keys of a closed block: row 0, and the others."""
    tag, *keys = extract(block.nonces, block.rows, block.by_words)
    shown = tag[: TAG_DIGITS // 2].hex()
    return ExtractedBlock(block.session, block.number, shown, tuple(keys))
