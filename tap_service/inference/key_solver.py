"""What a tap can compute of a key block, exactly: the eavesdropper who goes for the keys.

She missed e of the counted copies; the block has R rows. She knows the matrix, the pattern of what
counted, and the nonces she heard, and solves the linear system for whatever it gives: elimination
over the field finds the combinations of rows that no missed nonce enters. For the Cauchy matrix
there are R - min(R, e), so she holds w max(0, R - e) bits.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from protocol.secret.extractor import cauchy, words
from protocol.secret.galois import Words, eliminate, product
from protocol.secret.nonces import NONCE_BYTES


class KnownCombinations(NamedTuple):
    """What she can compute of a block's rows.

    Parameters
    ----------
    rows : int
    missed : int
        Counted copies that she missed.
    bits : int
        Dimension of what she knows of the rows, times the bits of a row.
    combinations : array, shape (bits / w, rows)
        Combinations of rows that she knows.
    values : array, shape (bits / w, words)
        Their values, as she computes them from the copies she heard.
    """

    rows: int
    missed: int
    bits: int
    combinations: Words
    values: Words


def held(nonces: Sequence[bytes | None], rows: int) -> KnownCombinations:
    """Solve the block's linear system for whatever the tap can.

    Parameters
    ----------
    nonces : sequence of bytes or None
        The counted copies in order; None where she missed one.
    rows : int
        R, rows of the block, the public one included.
    """
    missed = [j for j, nonce in enumerate(nonces) if nonce is None]
    heard = [j for j, nonce in enumerate(nonces) if nonce is not None]
    G = cauchy(rows, len(nonces))
    unit = np.eye(rows, dtype=np.uint16)
    reduced, rank = eliminate(np.hstack((G[:, missed], unit)), len(missed))
    combinations = reduced[rank:, len(missed) :]
    present = [nonce for nonce in nonces if nonce is not None]
    known = product(G[:, heard], words(present))
    return KnownCombinations(
        rows=rows,
        missed=len(missed),
        bits=8 * NONCE_BYTES * (rows - rank),
        combinations=combinations,
        values=product(combinations, known),
    )


def within(combinations: Words, values: Words, rows: Sequence[int]) -> tuple[Words, Words]:
    """Of what she knows of all rows, what speaks of some of them alone.

    Parameters
    ----------
    combinations, values : array, shapes (known, all rows) and (known, words)
    rows : sequence of int
        Which rows.

    Returns
    -------
    tuple of array, shapes (r, len(rows)) and (r, words)
        Independent combinations of these rows in reduced form, so that a row that she knows stands
        alone, and their values.
    """
    others = np.setdiff1d(np.arange(combinations.shape[1]), rows)
    ordered = np.hstack((combinations[:, others], combinations[:, list(rows)], values))
    reduced, rank = eliminate(ordered, len(others))
    left, rank = eliminate(reduced[rank:, len(others) :], len(rows))
    return left[:rank, : len(rows)], left[:rank, len(rows) :]


def bits_held(rows: int, missed: int) -> int:
    """What :func:`held` counts, without the algebra: every square part is invertible."""
    return 8 * NONCE_BYTES * max(0, rows - missed)
