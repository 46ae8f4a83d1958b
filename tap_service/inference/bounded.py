"""What a bounded disturbance says beyond its variance."""

from typing import Final

import numpy as np

from protocol.arrays import Array

CELLS: Final = 1024
"""Of a density, over four times its support."""

NEVER: Final = -30.0
"""Log ratio of what cannot be."""

GAUSSIAN: Final = 0.7
"""Deviation of an error, over the reach of a disturbance, from which their sum is as Gaussian."""

STEPS: Final = 12.0
"""Deviations of errors are told apart by a twelfth of a doubling."""


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
        self._widths = np.abs(C) * reach
        self._tables: dict[tuple[int, int], tuple[Array, Array]] = {}

    def log_ratio(self, off: Array, wide: Array) -> Array:
        """Log of the density over the Gaussian's, summed over rows; shape (...,).

        Parameters
        ----------
        off : array, shape (..., r)
        wide : array, shape (..., r)
            Deviation of e, or what broadcasts to it.
        """
        out = np.zeros(off.shape[:-1])
        for r, reach in enumerate(self._reach):
            least = 16 * reach / CELLS
            level = STEPS * np.log2(np.maximum(wide[..., r], least) / reach)
            level = np.round(np.minimum(level, STEPS)).astype(int)
            level = np.broadcast_to(level, out.shape)
            for step in np.unique(level).tolist():
                deviation = reach * 2 ** (step / STEPS)
                if deviation < GAUSSIAN * reach:
                    mine = level == step
                    at, log = self._table(r, step, deviation)
                    out[mine] += np.interp(off[mine, r], at, log, left=NEVER, right=NEVER)
        return out

    def _table(self, r: int, step: int, deviation: float) -> tuple[Array, Array]:
        """Places and the log ratio there."""
        if (r, step) not in self._tables:
            reach, widths = self._reach[r], self._widths[r]
            length = 8 * reach
            grid = 2 * np.pi * np.fft.rfftfreq(CELLS, length / CELLS)
            wave = np.prod(np.sinc(np.outer(widths, grid) / np.pi), axis=0)
            wave = wave * np.exp(-0.5 * (grid * deviation) ** 2)
            density = np.fft.fftshift(np.fft.irfft(wave, CELLS)) * CELLS / length
            at = (np.arange(CELLS) - CELLS // 2) * length / CELLS
            variance = (widths**2).sum() / 3 + deviation**2
            gauss = -0.5 * at**2 / variance - 0.5 * np.log(2 * np.pi * variance)
            # beyond the support it falls as a Gaussian of the other deviation
            beyond = np.maximum(np.abs(at) - reach, 0.0) / deviation
            least = -0.5 * beyond**2 - np.log(2 * reach) + np.where(beyond > 0, -1.0, 0.0)
            log = np.where(density > 1e-6 / reach, np.log(np.maximum(density, 1e-300)), least)
            self._tables[r, step] = at, np.maximum(log - gauss, NEVER)
        return self._tables[r, step]
