"""Sessions of a plant: excited, to find a model; under a law, to see what D_c must hold."""

from collections.abc import Callable
from dataclasses import dataclass
from operator import add
from pathlib import Path

import numpy as np

from plant_service.adapters import Operated
from plant_service.disturbance import disturbance
from protocol.arrays import Array
from protocol.scenario import Scenario
from wyner.simulate.single import Law, simulate_plant, step_plant

OpenPlant = Callable[[Scenario], Operated]


@dataclass(frozen=True, eq=False)
class Transitions:
    """x, u and x+ of many steps as they were read, shapes (T, n), (T, m), (T, n).

    Step i is of session ``i // steps``.
    """

    x: Array
    u: Array
    x_next: Array
    steps: int


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

    Nothing is chosen from candidates here, so this is not the closed loop of
    :mod:`wyner.simulate.single`; a model is fitted to what the plant says it applied.

    Parameters
    ----------
    scenario : Scenario
        Its U, its stated gain and its plant; its model does not matter.
    open_plant : callable
    sessions, steps : int
        An unstable plant wants many short ones.
    amplitude : float
        Of the random part, as a share of U.
    seed : int
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0,)))
    widths = _reach(scenario) * amplitude
    gain = None if scenario.control.gain is None else np.array(scenario.control.gain)
    rows: list[tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]] = []
    spec = scenario.plant.disturbance
    for session in range(sessions):
        plant = open_plant(scenario)
        noise = _noise(scenario, rng, steps)
        sensors = _sensor_noise(scenario, rng, steps + 1)
        try:
            x = _read(plant.start(seed + session), sensors[0])
            for k in range(steps):
                v = rng.uniform(-widths, widths)
                wanted = v if gain is None else v + gain @ np.array(x)
                u, came = step_plant(plant, spec, tuple(wanted.tolist()), noise[k] or None)
                x_next = _read(came, sensors[k + 1])
                rows.append((x, u, x_next))
                x = x_next
        finally:
            plant.close()
    x_all, u_all, next_all = (np.array(column) for column in zip(*rows, strict=True))
    return Transitions(x_all, u_all, next_all, steps)


def _reach(scenario: Scenario) -> Array:
    """Half-widths of the largest box that is surely within U, by component: a cube's for others."""
    inputs = scenario.control.inputs
    if inputs.half_widths is not None:
        return np.array(inputs.half_widths)
    H, h = (np.array(a) for a in inputs.rows())
    return np.full(scenario.m, float((h / np.abs(H).sum(axis=1)).min()))


def _noise(scenario: Scenario, rng: np.random.Generator, steps: int) -> list[tuple[float, ...]]:
    spec = scenario.plant.disturbance
    uniforms = rng.random((steps, len(spec.half_widths))).tolist()
    return [disturbance(spec, k, row) for k, row in enumerate(uniforms)]


def _sensor_noise(
    scenario: Scenario, rng: np.random.Generator, count: int
) -> list[tuple[float, ...]]:
    """What simulated sensors add to so many readings; nothing where they add nothing."""
    spec = scenario.plant.noise
    if spec is None:
        return [()] * count
    return [spec.drawn(row) for row in rng.random((count, spec.dimension)).tolist()]


def _read(x: tuple[float, ...], n: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(map(add, x, n)) if n else x


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
    record = simulate_plant(
        scenario,
        law,
        lambda: open_plant(scenario),
        seed=seed,
        runs=runs,
        steps=steps,
        folder=folder,
    )
    assert record.x is not None
    assert record.u is not None
    x, u = np.moveaxis(record.x, 2, 0), np.moveaxis(record.u, 2, 0)
    out: Array = x[:, 1:] - x[:, :-1] @ np.array(scenario.A).T - u @ np.array(scenario.B).T
    return out
