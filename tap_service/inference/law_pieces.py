"""Affine pieces of a law, found in exact pairs of states and answers.

Close neighbours share a region, so that an affine fit through a few of them either holds exactly
for many other pairs, and is a piece of the law, or for none.
"""

from typing import Final

import numpy as np

from protocol.arrays import Array

EXACT: Final = 1e-6
"""Residual, over the spread of the answers, up to which a pair lies on a piece."""

SUPPORT: Final = 6
"""Pairs beyond those it was drawn through that a piece must explain."""

PIECES: Final = 24
"""Pieces looked for."""

TRIES: Final = 120
"""Affine fits tried."""

TINY: Final = 1e-9


def affine_pieces(x: Array, values: Array) -> Array:
    """Slope and offset of each piece, shape (P, n + 1).

    Parameters
    ----------
    x : array, shape (N, n)
    values : array, shape (N,)
    """
    count, n = x.shape
    tolerance = EXACT * max(float(values.std()), TINY)
    scale = np.maximum(x.std(axis=0), TINY)
    left = np.hstack([x, np.ones((count, 1))])
    explained = np.zeros(count, dtype=bool)
    pieces: list[Array] = []
    rng = np.random.default_rng(0)
    for _ in range(TRIES):
        left_over = np.flatnonzero(~explained)
        if len(left_over) < SUPPORT + n + 1 or len(pieces) == PIECES:
            break
        seed = rng.choice(left_over)
        distance = (((x[left_over] - x[seed]) / scale) ** 2).sum(axis=1)
        near = left_over[np.argsort(distance)[: n + 3]]
        chosen = rng.choice(near, n + 1, replace=False)
        try:
            piece = np.linalg.solve(left[chosen], values[chosen])
        except np.linalg.LinAlgError:
            continue
        on = np.abs(values - left @ piece) < tolerance
        if (on & ~explained).sum() < n + 1 + SUPPORT:
            continue
        piece = np.linalg.lstsq(left[on], values[on], rcond=None)[0]
        explained |= np.abs(values - left @ piece) < tolerance
        pieces.append(piece)
    return np.array(pieces).reshape(-1, n + 1)
