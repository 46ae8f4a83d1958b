"""Data that no sweep gives: what taps get under each disturbance, and sets in the plane."""

from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any, Final

import numpy as np

from controller_service.laws.base import CandidateLaw
from controller_service.laws.registry import cached_design, make_law
from protocol.agreement import NO_SYMBOL, Gauge, predict
from protocol.convex import Polytope, planar_vertices
from protocol.scenario import Scenario
from runtime.scenario_file import load_scenario
from runtime.shipped import SCENARIOS
from studies.registry import study
from wyner.simulate.engine import simulate_runs, transfer
from wyner.simulate.engine.taps import listen
from wyner.sweeps import SWEEPS
from wyner.sweeps.grid import Point, load_sweep, points_of

SEED: Final = 7
ALPHAS: Final = (1.5, 3.0, 8.0)
INITIAL_STATES: Final = ((1.0, -0.5), (4.0, -2.0), (-12.0, 6.0))
MESSAGE: Final = b"We sail at dawn."
TAP_RUNS, TAP_STEPS = 20, 1500
SHOWN_SETS: Final = (0, 1, 2, 3, 4, 6, 8)

TAP_COLUMNS: Final = (
    "variant alpha runs steps seed agreements nearest_right delivered read_by_list_decoder"
)
SET_COLUMNS: Final = "seed kind name index x_1 x_2"


@cache
def system(name: str) -> tuple[Scenario, CandidateLaw]:
    """A shipped scenario with its law."""
    scenario = load_scenario(SCENARIOS / f"{name}.toml")
    return scenario, make_law(scenario, cached_design(scenario))


def starting_at(scenario: Scenario, x: Sequence[float]) -> Scenario:
    """The scenario from another initial state."""
    plant = scenario.plant.model_copy(update={"initial_state": tuple(x)})
    return scenario.model_copy(update={"plant": plant})


def tap_row(point: Point, runs: int, steps: int) -> tuple[Any, ...]:
    """What two taps get of a framed message under one kind of disturbance."""
    scenario = point.scenario
    law = make_law(scenario, cached_design(scenario))
    sample = simulate_runs(scenario, law, seed=SEED, runs=range(runs), steps=steps, record=True)
    sent = transfer(sample, payloads=[MESSAGE])
    heard = [listen(sample, sent, ("nearest-centre", "list-decoder"), r) for r in range(runs)]
    return (
        point.variant,
        scenario.secrecy.alpha,
        runs,
        steps,
        SEED,
        sum(nearest.agreements for nearest, _ in heard),
        sum(nearest.right for nearest, _ in heard),
        sum(decoder.delivered for _, decoder in heard),
        sum(decoder.read for _, decoder in heard),
    )


@study("taps", TAP_COLUMNS)
def tap_rows(_: None, runs: int = TAP_RUNS, steps: int = TAP_STEPS) -> Iterator[tuple[Any, ...]]:
    """What the taps get under each disturbance of the sweep ``disturbances``, at alpha = 8."""
    file = SWEEPS / "disturbances.toml"
    for point in points_of(load_sweep(file), file.parent):
        if point.scenario.secrecy.alpha == max(ALPHAS):
            yield tap_row(point, runs, steps)


@study("sets", SET_COLUMNS)
def set_rows(_: None) -> Iterator[tuple[Any, ...]]:
    """Corners of some T_i, trajectories through them, and one step's picture (Fig. 4)."""
    scenario, law = system("sustained")
    for i in SHOWN_SETS:
        for x in planar_vertices(Polytope(*law.design.set(i))).tolist():
            yield SEED, "set", f"T_{i}", i, *x
    for name in ("paper", "sustained"):
        for start in INITIAL_STATES[:2]:
            base, one_law = system(name)
            run = simulate_runs(
                starting_at(base, start), one_law, seed=SEED, runs=range(1), steps=50, record=True
            )
            assert run.x is not None
            for k, x in enumerate(run.x[:, :, 0].tolist()):
                yield SEED, "trajectory", f"{name} {start[0]:g}", k, *x
    run = simulate_runs(scenario, law, seed=SEED, runs=range(1), steps=200, record=True)
    assert run.x is not None
    assert run.candidates is not None
    in_diff = (run.symbol[:, 0] != NO_SYMBOL) & (run.largest[:, 0] <= 3.0)
    k = int(np.flatnonzero(in_diff & (np.arange(200) >= 20))[0])
    x = run.x[k, :, 0].tolist()
    for i, u in enumerate(run.candidates[k, :, :, 0].tolist()):
        yield SEED, "step", f"c_{i}", k, *predict(scenario.A, scenario.B, x, u)
    yield SEED, "step", "x(k+1)", k, *run.x[k + 1, :, 0].tolist()
    widths = Gauge.from_rows(*scenario.defender.disturbance.rows()).half_widths
    assert widths is not None
    yield SEED, "step", "D_c", k, *widths
