"""Random numbers of many runs: exactly those that each run's own seeded streams would give."""

import math
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from protocol.arrays import Array, Symbols
from protocol.scenario import Disturbance, Scenario
from protocol.streams import CIPHER, COIN, DISTURBANCE, generator


class Draws(Protocol):
    """What chance does to runs together.

    Attributes
    ----------
    at_once : int
        Steps that are drawn at a time.
    """

    at_once: int

    def block(self, k: int, steps: int) -> tuple[Array, Symbols]:
        """d and the coins of ``steps`` steps from ``k`` on: shapes (steps, n, R), (steps, R)."""


class SeededDraws:
    """Those of each run's own streams; the services with a seed are run 0.

    Parameters
    ----------
    scenario : Scenario
    seed : int
        The experiment's seed.
    runs : sequence of int
        Numbers of the runs.
    """

    at_once = 256

    def __init__(self, scenario: Scenario, seed: int, runs: Sequence[int]) -> None:
        self._spec, self._size = scenario.plant.disturbance, scenario.secrecy.candidates
        self._n, self._runs = scenario.n, len(runs)
        self._noise = Streams(seed, runs, DISTURBANCE)
        self._coins = Streams(seed, runs, COIN)

    def block(self, k: int, steps: int) -> tuple[Array, Symbols]:
        """See :meth:`Draws.block`."""
        noise = self._noise.take(steps * self._n).reshape(self._runs, steps, self._n)
        d = disturbances(self._spec, k, np.ascontiguousarray(noise.transpose(1, 2, 0)))
        coins = self._coins.take(steps).T * self._size
        return d, coins.astype(symbol_type(self._size))


class Streams:
    """One stream of each run."""

    def __init__(self, seed: int, runs: Sequence[int], stream: int) -> None:
        self._generators = [generator(seed, run, stream) for run in runs]

    def take(self, count: int) -> Array:
        """The next ``count`` numbers of each run, shape (R, count)."""
        out = np.empty((len(self._generators), count))
        for row, of_run in zip(out, self._generators, strict=True):
            of_run.random(out=row)
        return out


def symbol_type(size: int) -> type[np.integer[Any]]:
    """The smallest integer that holds -1 to M - 1."""
    return np.int8 if size <= 128 else np.int16


def cipher_symbols(seed: int, runs: Sequence[int], steps: int, size: int) -> Symbols:
    """The random cipher symbol of each transition, shape (steps, R), in range(size)."""
    drawn = Streams(seed, runs, CIPHER).take(steps) * size
    return drawn.astype(symbol_type(size)).T.copy()


def disturbances(spec: Disturbance, first_step: int, uniforms: Array) -> Array:
    """d of consecutive steps, the same numbers as :func:`plant_service.disturbance.disturbance`.

    Parameters
    ----------
    spec : Disturbance
    first_step : int
        Step of ``uniforms[0]``.
    uniforms : array, shape (steps, n, R)

    Returns
    -------
    array, shape (steps, n, R)
    """
    w = np.array(spec.half_widths)[:, None]
    out: Array
    if spec.kind == "uniform":
        out = (2.0 * uniforms - 1.0) * w
    elif spec.kind == "corners":
        out = np.where(uniforms >= 0.5, w, -w)
    elif spec.kind == "constant":
        out = np.broadcast_to(spec.bias * w, uniforms.shape).copy()
    elif spec.kind == "sinusoid":
        # The library's sine of each step, as the plant takes it.
        steps = range(first_step, first_step + len(uniforms))
        phase = np.array([math.sin(2.0 * math.pi * k / spec.cycle_steps) for k in steps])
        out = np.broadcast_to(phase[:, None, None] * w, uniforms.shape).copy()
    else:
        from scipy.special import ndtr, ndtri

        if spec.kind == "gaussian":
            standard = ndtri(np.maximum(uniforms, 2.0**-54))
        else:
            low = float(ndtr(-1.0 / spec.deviation))
            span = 1.0 - 2.0 * low
            standard = ndtri(low + span * uniforms)
        out = (spec.deviation * w) * standard
    return out
