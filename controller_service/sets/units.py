"""Units of the states in which sets are computed.

A plant may state one coordinate in micrometres and another in kilometres. Angles between rows, and
tolerances of the work on them, would then depend on that choice. Where the coordinates that the
disturbance reaches differ by more than SPREAD, each is counted in a power of two near its own
reach. Powers of two change no digit.
"""

from typing import Final

import numpy as np

from protocol.arrays import Array

SPREAD: Final = 64.0
"""Reaches that differ by no more than this factor are left in the plant's units."""


def state_units(A: Array, V: Array) -> Array | None:
    """The unit of each coordinate, shape (n,); None where the plant's own do.

    Parameters
    ----------
    A : array, shape (n, n)
    V : array, shape (corners, n)
        Corners of the disturbance. What it reaches in n steps counts: it may enter one state alone
        and be passed on to the others.
    """
    reach = np.zeros(len(A))
    for _ in range(len(A)):
        reach = np.maximum(reach, np.abs(V).max(axis=0))
        V = V @ A.T
    if reach.max() <= SPREAD * reach.min():
        return None
    out: Array = 2.0 ** np.round(np.log2(reach / reach.max()))
    return out


def in_units(A: Array, units: Array | None) -> Array:
    """A square matrix of the states, in these units of the states."""
    return A if units is None else A * units / units[:, None]
