"""Sessions of a plant: excited, to find a model; under a law, to see what D_c must hold."""

from pathlib import Path
from typing import Final

import numpy as np

from controller_service.laws.registry import cached_design, make_law
from controller_service.progress import shown_progress
from controller_service.sets.design import SynthesisError
from plant_service.adapters.base import PlantAdapter, Stepped
from plant_service.adapters.registry import open_plant
from protocol.agreement import Gauge
from protocol.arrays import Array
from protocol.link.fallback import clip
from protocol.scenario import Scenario
from protocol.vectors import Vector
from wyner.fit.plan import Plan
from wyner.simulate.engine import Law, simulate_runs

Own = Stepped | PlantAdapter

EXCITED: Final = 1_000_000
"""Number of the first excited session, so that none shares its draws with a session of the law."""


class _Excitation:
    """A law whose only candidate is random, beside K x where ``control.gain`` is stated."""

    def __init__(self, scenario: Scenario, plan: Plan) -> None:
        self._random = np.random.default_rng(np.random.SeedSequence(plan.seed, spawn_key=(0,)))
        self._widths = _reach(scenario) * plan.amplitude
        gain = scenario.control.gain
        self._gain = np.zeros((scenario.m, scenario.n)) if gain is None else np.array(gain)
        self._inputs = Gauge.from_rows(*scenario.control.inputs.rows())
        self._size = scenario.secrecy.candidates

    def candidates(self, x: Vector, /) -> tuple[Vector, ...]:
        """The same input M times, within U."""
        v = self._random.uniform(-self._widths, self._widths) + self._gain @ np.array(x)
        return (clip(v.tolist(), self._inputs),) * self._size


def _reach(scenario: Scenario) -> Array:
    """Half-widths of the largest box that is surely within U, by component: a cube's for others."""
    inputs = scenario.control.inputs
    if inputs.half_widths is not None:
        return np.array(inputs.half_widths)
    H, h = (np.array(a) for a in inputs.rows())
    return np.full(scenario.m, float((h / np.abs(H).sum(axis=1)).min()))


def excite(
    scenario: Scenario, folder: Path, plan: Plan, own: Own | None = None
) -> tuple[Array, Array]:
    """Apply random inputs, beside u = K x where ``control.gain`` is stated.

    Parameters
    ----------
    scenario : Scenario
        Its U, its stated gain and its plant; its model and its network do not matter.
    folder : Path
        Where the files that it names are looked for.
    plan : Plan
        An unstable plant wants many short sessions.
    own : Stepped or PlantAdapter, optional
        A plant in place of the one that the scenario names.

    Returns
    -------
    x, u : array, shapes (sessions, steps + 1, n) and (sessions, steps, m)
        As they were read, and as they were applied.
    """
    alone = scenario.model_copy(update={"network": None})
    runs = range(EXCITED, EXCITED + plan.few)
    law = _Excitation(alone, plan)
    return _recorded(alone, law, folder, own, runs, plan.excite_steps, plan.seed)


def residuals_under(
    scenario: Scenario, folder: Path, plan: Plan, runs: range, own: Own | None = None
) -> Array:
    """x+ - A x - B u of every step of whole sessions under the law, shape (sessions, steps, n).

    Of readings: where sensors are noisy each is d + n(k+1) - A n(k). A step that the network missed
    counts with the fallback's input.

    Raises
    ------
    SynthesisError
        When there are no sets for its D_c.
    """
    try:
        # The same fit again, as after Ctrl-C, makes the same sets and finds them in the cache.
        with shown_progress() as progress:
            law = make_law(scenario, cached_design(scenario, progress))
    except SynthesisError as error:
        widths = scenario.defender.disturbance.half_widths or ()
        raise SynthesisError(
            f"{error} (D_c has half-widths {[float(f'{w:.4g}') for w in widths]}: a smaller "
            "--amplitude shows less of what the model leaves out)"
        ) from None
    x, u = _recorded(scenario, law, folder, own, runs, plan.steps, plan.seed)
    return residuals(x, u, np.array(scenario.A), np.array(scenario.B))


def residuals(x: Array, u: Array, A: Array, B: Array) -> Array:
    """x+ - A x - B u of every step, shape (sessions, steps, n)."""
    out: Array = x[:, 1:] - x[:, :-1] @ A.T - u @ B.T
    return out


def _recorded(
    scenario: Scenario,
    law: Law,
    folder: Path,
    own: Own | None,
    runs: range,
    steps: int,
    seed: int,
) -> tuple[Array, Array]:
    """Readings and inputs of sessions, the plant itself opened for each."""
    made = simulate_runs(
        scenario,
        law,
        seed=seed,
        runs=runs,
        steps=steps,
        record=True,
        folder=folder,
        plant=lambda: open_plant(scenario, folder, own),
    )
    assert made.x is not None
    assert made.u is not None
    return np.moveaxis(made.x, 2, 0), np.moveaxis(made.u, 2, 0)
