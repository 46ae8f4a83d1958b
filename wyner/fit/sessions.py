"""Sessions of a plant: excited, to find a model; under a law, to see what D_c must hold."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from plant_service.adapters import Operated
from protocol.agreement import Gauge
from protocol.arrays import Array
from protocol.link.fallback import clip
from protocol.scenario import Scenario
from protocol.vectors import Vector
from wyner.simulate.engine import Law, Runs, simulate_runs

OpenPlant = Callable[[Scenario], Operated]

EXCITED: Final = 1_000_000
"""Number of the first excited session, so that none shares its draws with a session of the law."""


@dataclass(frozen=True, eq=False)
class Transitions:
    """x, u and x+ of many steps as they were read, shapes (T, n), (T, m), (T, n).

    Step i is of session ``i // steps``.
    """

    x: Array
    u: Array
    x_next: Array
    steps: int


class _Excitation:
    """A law whose only candidate is random, beside K x where ``control.gain`` is stated."""

    def __init__(self, scenario: Scenario, amplitude: float, seed: int) -> None:
        self._random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0,)))
        self._widths = _reach(scenario) * amplitude
        gain = scenario.control.gain
        self._gain = np.zeros((scenario.m, scenario.n)) if gain is None else np.array(gain)
        self._inputs = Gauge.from_rows(*scenario.control.inputs.rows())
        self._size = scenario.secrecy.candidates

    def candidates(self, x: Vector, /) -> tuple[Vector, ...]:
        """The same input M times, within U."""
        v = self._random.uniform(-self._widths, self._widths) + self._gain @ np.array(x)
        u: Vector = tuple(v.tolist())
        return (u if self._inputs(u) <= 1 else clip(u, self._inputs),) * self._size


def excite(
    scenario: Scenario,
    open_plant: OpenPlant,
    *,
    sessions: int,
    steps: int,
    amplitude: float,
    seed: int,
) -> Transitions:
    """Apply random inputs, beside u = K x where ``control.gain`` is stated.

    Parameters
    ----------
    scenario : Scenario
        Its U, its stated gain and its plant; its model and its network do not matter.
    open_plant : callable
    sessions, steps : int
        An unstable plant wants many short ones.
    amplitude : float
        Of the random part, as a share of U.
    seed : int
    """
    alone = scenario.model_copy(update={"network": None})
    runs = range(EXCITED, EXCITED + sessions)
    x, u = _recorded(alone, _Excitation(alone, amplitude, seed), open_plant, seed, runs, steps)
    before, inputs, after = (a.reshape(-1, a.shape[2]) for a in (x[:, :-1], u, x[:, 1:]))
    return Transitions(before, inputs, after, steps)


def _reach(scenario: Scenario) -> Array:
    """Half-widths of the largest box that is surely within U, by component: a cube's for others."""
    inputs = scenario.control.inputs
    if inputs.half_widths is not None:
        return np.array(inputs.half_widths)
    H, h = (np.array(a) for a in inputs.rows())
    return np.full(scenario.m, float((h / np.abs(H).sum(axis=1)).min()))


def _recorded(
    scenario: Scenario,
    law: Law,
    open_plant: OpenPlant,
    seed: int,
    runs: range,
    steps: int,
    folder: Path = Path(),
) -> tuple[Array, Array]:
    """Readings and inputs of sessions, shapes (sessions, steps + 1, n) and (sessions, steps, m)."""
    made: Runs = simulate_runs(
        scenario,
        law,
        seed=seed,
        runs=runs,
        steps=steps,
        record=True,
        folder=folder,
        plant=lambda: open_plant(scenario),
    )
    assert made.x is not None
    assert made.u is not None
    return np.moveaxis(made.x, 2, 0), np.moveaxis(made.u, 2, 0)


def residuals_under(
    scenario: Scenario,
    law: Law,
    open_plant: OpenPlant,
    *,
    runs: range,
    steps: int,
    seed: int,
    folder: Path = Path(),
) -> Array:
    """x+ - A x - B u of every step of whole sessions under the law, shape (sessions, steps, n).

    Of readings: where sensors are noisy each is d + n(k+1) - A n(k). A step that the network missed
    counts with the fallback's input.
    """
    x, u = _recorded(scenario, law, open_plant, seed, runs, steps, folder)
    out: Array = x[:, 1:] - x[:, :-1] @ np.array(scenario.A).T - u @ np.array(scenario.B).T
    return out
