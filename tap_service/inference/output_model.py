"""Her model where some outputs alone are read, y = C x + n: what may have been applied, followed.

She knows f_c, C and D_e, and neither D_c nor N. A Kalman filter that takes the sensors for nearly
exact goes along the likeliest sequences of candidates: what was applied shows some readings later.

Both ends begin with a box as wide as the plant's bounds, and agree on nothing until it tells the
candidates apart. From then on it does at every step, so all that is hidden of a session is how many
of its first steps they lost: 1 to 8 in 400 runs of the scenario ``encoder``.
"""

from collections.abc import Sequence
from copy import copy
from typing import Final

import numpy as np

from protocol.arrays import Array, Integers
from protocol.box_observer import BoxObserver
from protocol.vectors import Matrix, Vector

SENSOR: Final = 1e-3
"""Deviation of a sensor's noise that she assumes, over what D_e does to the reading in a step."""

STEPS: Final = 500
"""Of the filter's equations, until the gain has settled."""

ANYWHERE: Final = 1e4
"""Deviation of the state before the first reading, in units of D_e."""

LATER: Final = 12
"""Readings after which she decides what was applied before them."""

SETTLING: Final = 64
"""Readings in a row from which the filter's gain is the settled one."""

LOST: Final = 16
"""Steps at a session's beginning, one of which is the first that the ends agreed on."""

PATHS: Final = 64
"""Sequences of candidates that she follows at once."""


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
        self._A, self._B, self._C = np.array(A), np.array(B), np.array(C)
        nothing = (0.0,) * len(C)
        bounds = tuple(ANYWHERE * w for w in widths)
        observer = BoxObserver(A, B, C, widths, nothing, bounds)
        E = observer.quiet()
        box = observer.begin(nothing)._replace(low=tuple(-e for e in E), high=E)
        self._reach = np.array(observer.reach(box))
        self._Q = np.diag(np.square(widths))
        self._R = np.diag((SENSOR * np.abs(self._C) @ widths) ** 2)
        self._far = np.diag(np.square(bounds))
        self._settled = self._settled_spread()
        self._means: Array
        self._spread: Array
        self._cost: Array
        self._applied: Integers
        self._last: Vector = ()
        self.readings = 0
        """Readings in a row."""
        self._begin(nothing)

    def anew(self) -> "OutputModel":
        """The same, with nothing heard."""
        made = copy(self)
        made._last = ()
        return made

    @property
    def settled(self) -> bool:
        """Whether as many readings in a row were heard as there are states."""
        return self.readings > len(self.A)

    @property
    def applied(self) -> list[int]:
        """The candidates of the likeliest sequence, in the last steps that came in a row."""
        return [int(c) for c in self._applied[int(self._cost.argmin())]]

    def gauges(
        self,
        x: Sequence[float],
        candidates: Sequence[Sequence[float]],
        x_next: Sequence[float],
        predictions: Sequence[Sequence[float]] = (),
    ) -> list[float]:
        """How far the reading is from each candidate's on the likeliest way, in what D_e allows."""
        assert not predictions, "outputs go with a linear f_c"
        if tuple(x) != self._last:  # some steps were missed
            self._begin(x)
        gain, inverse = self._gain()
        pushes = np.array(candidates) @ self._B.T
        centres = (self._means @ self._A.T)[:, None] + pushes
        surprise = np.array(x_next) - centres @ self._C.T
        likeliest = int(self._cost.argmin())
        found: list[float] = (np.abs(surprise[likeliest]) / self._reach).max(axis=1).tolist()
        cost = self._cost[:, None] + np.einsum("hmr,rs,hms->hm", surprise, inverse, surprise)
        best = np.argsort(cost, axis=None, kind="stable")[:PATHS]
        way, candidate = np.unravel_index(best, cost.shape)
        self._means = centres[way, candidate] + surprise[way, candidate] @ gain.T
        self._cost = cost[way, candidate] - cost.min()
        self._applied = np.column_stack((self._applied[way][:, -LATER:], candidate))
        self._last = tuple(x_next)
        self.readings += 1
        return found

    along_the_widest = gauges
    """The readings are the widest there is."""

    def _begin(self, y: Sequence[float]) -> None:
        """Nothing is known but one reading."""
        gain = self._far @ self._C.T @ np.linalg.inv(self._C @ self._far @ self._C.T + self._R)
        self._spread = (np.eye(len(self._A)) - gain @ self._C) @ self._far
        self._means = (gain @ np.array(y))[None]
        self._cost = np.zeros(1)
        self._applied = np.zeros((1, 0), int)
        self.readings = 1

    def _gain(self) -> tuple[Array, Array]:
        """The filter's gain, and the inverse spread of what a reading may differ by."""
        spread = self._settled
        if self.readings <= SETTLING:
            spread = self._A @ self._spread @ self._A.T + self._Q
        inverse = np.linalg.inv(self._C @ spread @ self._C.T + self._R)
        gain = spread @ self._C.T @ inverse
        self._spread = (np.eye(len(self._A)) - gain @ self._C) @ spread
        return gain, inverse

    def _settled_spread(self) -> Array:
        """Spread of the state before a reading, in the end; shape (n, n)."""
        spread = self._Q
        for _ in range(STEPS):
            gain = spread @ self._C.T @ np.linalg.inv(self._C @ spread @ self._C.T + self._R)
            spread = (np.eye(len(self._A)) - gain @ self._C) @ spread
            spread = self._A @ spread @ self._A.T + self._Q
        return spread
