"""The closed loop of any plant, one run after the other, with what the engine keeps of a run.

For plants that the engine cannot step: a function, an object, an FMU, an environment. The numbers
drawn are those of the engine and of the services with a seed, so that a linear plant gives the same
run here, there and on the network.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import numpy as np

from plant_service.adapters import Operated, PlantError
from plant_service.disturbance import disturbance
from protocol.agreement import INSIDE, NO_SYMBOL
from protocol.link.model import load_model
from protocol.link.session import rules_of
from protocol.scenario import Scenario
from protocol.streams import COIN, DISTURBANCE, SeededSymbols, Stream
from protocol.vectors import Vector
from wyner.simulate.engine.draws import symbol_type
from wyner.simulate.engine.loop import Runs, SimulationError


class Law(Protocol):
    """What the loop needs of a control law."""

    def candidates(self, x: Vector, /) -> tuple[Vector, ...]:
        """The M candidate inputs at ``x``."""


def simulate_plant(
    scenario: Scenario,
    law: Law,
    open_plant: Callable[[], Operated],
    *,
    seed: int,
    runs: range,
    steps: int,
    folder: Path = Path(),
) -> Runs:
    """Simulate ``runs`` of a plant, with a record.

    Parameters
    ----------
    scenario : Scenario
        Its agreement rule, candidates and disturbance.
    law : Law
    open_plant : callable
        A new plant for each run; it is closed when the run ends.
    seed : int
    runs : range
        Numbers of the runs, each with its own streams.
    steps : int
    folder : Path
        Where the file of a nonlinear f_c is looked for.

    Raises
    ------
    SimulationError
        When a state leaves every set, or the plant fails; the message names run and step.
    """
    n, m, M = scenario.n, scenario.m, scenario.secrecy.candidates
    spec = scenario.plant.disturbance
    width, in_state = len(spec.half_widths), spec.enters in (None, "state")
    R = len(runs)
    if R < 1 or steps < 1:
        raise ValueError(f"runs and steps: got {R} and {steps}, expected at least one of each")
    judge, predict = rules_of(scenario).judge, load_model(scenario, folder)
    coin = np.empty((steps, R), dtype=symbol_type(M))
    symbol = np.empty((steps, R), dtype=symbol_type(M))
    xs = np.empty((steps + 1, n, R))
    us = np.empty((steps, M, m, R))
    gs = np.empty((steps, M, R))
    for place, run in enumerate(runs):
        coins = SeededSymbols(seed, COIN, run=run)
        noise = Stream(seed, DISTURBANCE, width=width, run=run)
        plant = open_plant()
        try:
            x = plant.start(seed + run)
            xs[0, :, place] = x
            for k in range(steps):
                try:
                    candidates = law.candidates(x)
                    centres = () if predict is None else tuple([predict(x, u) for u in candidates])
                    b = coins.symbol(k, M)
                    d = None if width == 0 else disturbance(spec, k, noise.at(k))
                    plant.apply(candidates[b], d if spec.enters == "input" else None)
                    x_next = plant.sample(d if in_state else None)
                except (LookupError, PlantError) as error:
                    raise SimulationError(f"run {run}, step {k}: {error}") from None
                verdict = judge(x, candidates, centres, x_next)
                inside = [i for i, g in enumerate(verdict.gauges) if g <= INSIDE]
                coin[k, place] = b
                symbol[k, place] = inside[0] if len(inside) == 1 else NO_SYMBOL
                xs[k + 1, :, place] = x_next
                us[k, :, :, place] = candidates
                gs[k, :, place] = verdict.gauges
                x = x_next
        finally:
            plant.close()
    applied = np.take_along_axis(us, coin[:, None, None, :].astype(np.intp), axis=1)[:, 0]
    return Runs(
        scenario=scenario,
        seed=seed,
        runs=runs,
        coin=coin,
        symbol=symbol,
        largest=gs.max(axis=1),
        state_cost=(xs[1:] ** 2).sum(axis=(0, 1)),
        input_effort=(applied**2).sum(axis=(0, 1)),
        x=xs,
        candidates=us,
        gauges=gs,
    )
