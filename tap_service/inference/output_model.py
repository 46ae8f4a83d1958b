"""Her model where some outputs alone are read, y = C x + n: an estimate of the state as she goes.

She knows f_c, C and D_e, and neither D_c nor N. Her estimate is a Kalman filter's that takes the
sensors for nearly exact. It goes on with the candidate whose reading is nearest to the one heard.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from protocol.agreement import predict
from protocol.arrays import Array
from protocol.box_observer import BoxObserver
from protocol.vectors import Matrix, Vector

SENSOR: Final = 1e-3
"""Deviation of a sensor's noise that she assumes, over what D_e does to the reading in a step."""

STEPS: Final = 500
"""Of the filter's equations, until the gain has settled."""

ANYWHERE: Final = 1e6
"""Half-width of the box before the first reading, in units of D_e."""


class OutputModel:
    """Measures every candidate by its reading, and keeps an estimate of the state.

    One transition must be given once, in order.

    Parameters
    ----------
    A, B, C : tuple of tuple of float, shapes (n, n), (n, m) and (r, n)
    widths : tuple of float, shape (n,)
        Half-widths of a box around D_e.
    """

    def __init__(self, A: Matrix, B: Matrix, C: Matrix, widths: Vector) -> None:
        self.A, self.B = A, B
        nothing = (0.0,) * len(C)
        bounds = tuple(ANYWHERE * w for w in widths)
        observer = BoxObserver(A, B, C, widths, nothing, bounds)
        self._read = observer.read
        E = observer.quiet()
        box = observer.begin(nothing)._replace(low=tuple(-e for e in E), high=E)
        self._reach = observer.reach(box)
        self._gain = _gain(np.array(A), np.array(C), np.array(widths))
        self._x = np.zeros(len(A))
        self._last: Vector = ()
        self._readings = 0

    @property
    def settled(self) -> bool:
        """Whether as many readings in a row were heard as there are states."""
        return self._readings > len(self.A)

    def gauges(
        self,
        x: Sequence[float],
        candidates: Sequence[Sequence[float]],
        x_next: Sequence[float],
        predictions: Sequence[Sequence[float]] = (),
    ) -> list[float]:
        """How far the reading is from each candidate's, in what D_e allows; follows the nearest."""
        assert not predictions, "outputs go with a linear f_c"
        if tuple(x) != self._last:  # some steps were missed
            self._corrected(tuple(self._x.tolist()), x)
            self._readings = 1
        estimate = tuple(self._x.tolist())
        centres = [predict(self.A, self.B, estimate, u) for u in candidates]
        found = []
        for centre in centres:
            away = zip(x_next, self._read(centre), self._reach, strict=True)
            found.append(max(abs(y - c) / r for y, c, r in away))
        self._corrected(centres[found.index(min(found))], x_next)
        self._last = tuple(x_next)
        self._readings += 1
        return found

    along_the_widest = gauges
    """The readings are the widest there is."""

    def _corrected(self, expected: Vector, y: Sequence[float]) -> None:
        surprise = np.array(y) - np.array(self._read(expected))
        self._x = np.array(expected) + self._gain @ surprise


def _gain(
    A: Array,
    C: Array,
    widths: Array,
) -> Array:
    """The settled gain of the filter, shape (n, r)."""
    Q = np.diag(widths**2)
    R = np.diag((SENSOR * np.abs(C) @ widths) ** 2)
    P = Q.copy()
    gain = np.zeros((len(A), len(C)))
    for _ in range(STEPS):
        P = A @ P @ A.T + Q
        gain = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
        P = (np.eye(len(A)) - gain @ C) @ P
    return gain
