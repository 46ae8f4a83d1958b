"""Which candidate was applied, told from what Eve sees of the plant."""

from typing import Final

import numpy as np

from attacker_service.base import LoopModel
from protocol.arrays import Array, Integers

ROUNDS: Final = 200
"""Steps of the filter's recursion, after which its gain stands still."""


class Sight:
    """Follows the true plant through Eve's noise, and says which candidate moved it.

    A Kalman filter whose disturbance has the variance of a uniform one on D_c's axes. Where Eve
    sees without noise the candidate is the one that D_c explains: there is no other (equation 20).

    Parameters
    ----------
    model : LoopModel
    noise : float
        Standard deviation of Eve's noise on each state.
    """

    def __init__(self, model: LoopModel, noise: float) -> None:
        self._model = model
        self._exact = noise == 0
        n = len(model.A)
        process = np.diag(model.half_widths**2 / 3)
        seen = noise**2 * np.eye(n)
        P = np.zeros((n, n))
        for _ in range(ROUNDS):
            prior = model.A @ P @ model.A.T + process
            gain = prior @ np.linalg.inv(prior + seen)
            P = prior - gain @ prior
        self._gain = gain
        self._precision = np.linalg.inv(prior + seen)
        self._x: Array | None = None

    def stand(self, x: Array) -> None:
        """The true state is ``x``, shape (..., n)."""
        self._x = x

    def coins(self, candidates: Array, seen: Array) -> Integers:
        """The candidate that fits best to what is seen, shape (...,), for Observation's arrays."""
        assert self._x is not None
        off = seen[..., None, :] - self._model.predict(self._x[..., None, :], candidates)
        if self._exact:
            gauge = self._model.gauge(off)
        else:
            gauge = np.einsum("...i,ij,...j", off, self._precision, off)
        nearest: Integers = gauge.argmin(-1)
        return nearest

    def step(self, u: Array, seen: Array) -> None:
        """The input ``u``, shape (..., m), was applied, and ``seen`` is what came of it."""
        assert self._x is not None
        predicted = self._model.predict(self._x, u)
        self._x = predicted + (seen - predicted) @ self._gain.T


def chosen(candidates: Array, coins: Integers) -> Array:
    """The candidate of each run, shape (..., m)."""
    return np.take_along_axis(candidates, coins[..., None, None], -2)[..., 0, :]
