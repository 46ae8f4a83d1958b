"""What a tap can compute of a key block, by linear algebra over the field: whatever there is.

Elimination finds the combinations of rows that no missed nonce enters. The project counts them by a
formula; this is the yardstick that the formula is held against.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from protocol.secret.extractor import cauchy, words
from protocol.secret.galois import Words, inverse, multiply, product
from protocol.secret.nonces import NONCE_BYTES


def eliminate(matrix: Words, columns: int | None = None) -> tuple[Words, int]:
    """Reduced row echelon form over the first ``columns`` columns, and its rank.

    Parameters
    ----------
    matrix : array, shape (r, c)
    columns : int, optional
        Columns to look for pivots in; all by default. The others are carried along.

    Returns
    -------
    tuple
        The reduced matrix and its rank; from row ``rank`` on the first ``columns`` entries are 0.
    """
    rows = matrix.copy()
    rank = 0
    for j in range(rows.shape[1] if columns is None else columns):
        places = np.flatnonzero(rows[rank:, j])
        if not len(places):
            continue
        pivot = rank + int(places[0])
        if pivot != rank:
            rows[[rank, pivot]] = rows[[pivot, rank]]
        rows[rank] = multiply(rows[rank], inverse(rows[rank, j]))
        factors = rows[:, j].copy()
        factors[rank] = 0
        rows ^= multiply(factors[:, None], rows[rank][None, :])
        rank += 1
        if rank == rows.shape[0]:
            break
    return rows, rank


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
