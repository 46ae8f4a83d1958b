"""What a tap can compute of a key block, by linear algebra over the field: whatever there is.

Elimination finds the combinations of rows that no missed nonce enters.
"""

from collections.abc import Sequence

import numpy as np

from protocol.secret.galois import Words, inverse, multiply


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


def without(G: Words, gone: Sequence[int]) -> Words:
    """Combinations of the rows of a matrix that have zeros in these columns: all there are."""
    unit = np.eye(len(G), dtype=np.uint16)
    reduced, rank = eliminate(np.hstack((G[:, gone], unit)), len(gone))
    return reduced[rank:, len(gone) :]
