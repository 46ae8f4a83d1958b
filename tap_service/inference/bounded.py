"""What a bounded disturbance says beyond its variance."""

from typing import Final

import numpy as np

from protocol.arrays import Array

CELLS: Final = 1024
"""Of a density, over four times its support."""

NEVER: Final = -30.0
"""Log ratio of what cannot be."""


class BoundedRows:
    """Readings C d + e: d even over a box, e Gaussian; their densities over the Gaussian ones.

    Row by row, so that it is exact where e is small and rows are coordinates.

    Parameters
    ----------
    C : array, shape (r, n)
    reach : array, shape (n,)
    """

    def __init__(self, C: Array, reach: Array) -> None:
        self._reach = (np.abs(C) * reach).sum(axis=1)
        self._variance = (C**2 * reach**2).sum(axis=1) / 3
        self._waves = [self._wave_of(np.abs(row) * reach) for row in C]

    def _wave_of(self, widths: Array) -> Array:
        """The characteristic function of a sum of even disturbances, on the grid's frequencies."""
        total = float(widths.sum())
        grid = 2 * np.pi * np.fft.rfftfreq(CELLS, 8 * max(total, 1e-300) / CELLS)
        return np.asarray(np.prod(np.sinc(np.outer(widths, grid) / np.pi), axis=0))

    def log_ratio(self, off: Array, wide: Array) -> Array:
        """Log of the density over the Gaussian's, summed over rows.

        Parameters
        ----------
        off : array, shape (N, r)
        wide : array, shape (r,)
            Deviation of e.
        """
        out = np.zeros(len(off))
        for r, wave in enumerate(self._waves):
            reach, deviation = self._reach[r], float(wide[r])
            if deviation > 0.7 * reach:
                continue  # next to Gaussian
            length = 8 * reach
            deviation = max(deviation, 2 * length / CELLS)
            grid = 2 * np.pi * np.fft.rfftfreq(CELLS, length / CELLS)
            smooth = np.exp(-0.5 * (grid * deviation) ** 2)
            density = np.fft.fftshift(np.fft.irfft(wave * smooth, CELLS)) * CELLS / length
            at = (np.arange(CELLS) - CELLS // 2) * length / CELLS
            found = np.interp(off[:, r], at, density, left=0.0, right=0.0)
            variance = self._variance[r] + float(wide[r]) ** 2
            gauss = -0.5 * off[:, r] ** 2 / variance - 0.5 * np.log(2 * np.pi * variance)
            # beyond the support it falls as a Gaussian of the other deviation
            beyond = np.maximum(np.abs(off[:, r]) - reach, 0.0) / deviation
            least = -0.5 * beyond**2 - np.log(2 * reach) + np.where(beyond > 0, -1.0, 0.0)
            log = np.where(found > 1e-6 / reach, np.log(np.maximum(found, 1e-300)), least)
            out += np.maximum(log - gauss, NEVER)
        return out
