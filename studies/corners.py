"""A million steps whose every draw of d and n is a corner of what both ends assume: the keys."""

from collections.abc import Iterator
from typing import Any, Final

from controller_service.laws.registry import cached_design, make_law
from protocol.agreement import NO_SYMBOL
from protocol.scenario import Scenario, parse_scenario
from protocol.statistics import clopper_pearson, wilson
from runtime.scenario_file import load_scenario
from runtime.shipped import SCENARIOS
from studies.registry import study
from wyner.simulate.engine import simulate_runs

RUNS, AT_ONCE, STEPS, SEED = 2000, 100, 500, 11

COLUMNS: Final = "scenario candidates runs steps seed agreed agreed_low wrong wrong_high impossible"


def noisy_scenarios() -> Iterator[str]:
    """The shipped scenarios whose sensors are noisy, by name."""
    for path in sorted(SCENARIOS.glob("*.toml")):
        if load_scenario(path).plant.noise is not None:
            yield path.stem


def at_the_corners(name: str) -> Scenario:
    """A shipped scenario with d in the corners of D_c, and n in those of N."""
    base = load_scenario(SCENARIOS / f"{name}.toml")
    data = base.model_dump(mode="json", exclude_none=True)
    assumed = data["defender"]
    data["plant"]["disturbance"] = {"kind": "corners", **assumed["disturbance"]}
    data["plant"]["noise"] = {"kind": "corners", **assumed["noise"]}
    return parse_scenario(data, name)


@study("corners", COLUMNS, noisy_scenarios)
def corner_rows(name: str) -> Iterator[tuple[Any, ...]]:
    """The row of a scenario."""
    scenario = at_the_corners(name)
    law = make_law(scenario, cached_design(scenario))
    agreed = wrong = impossible = 0
    for first in range(0, RUNS, AT_ONCE):
        part = range(first, first + AT_ONCE)
        runs = simulate_runs(scenario, law, seed=SEED, runs=part, steps=STEPS)
        possible = runs.largest <= scenario.secrecy.alpha
        keys = possible & (runs.symbol != NO_SYMBOL)
        agreed += int(keys.sum())
        wrong += int((keys & (runs.symbol != runs.coin)).sum())
        impossible += int((~possible).sum())
    made = RUNS * STEPS
    yield (
        name,
        scenario.secrecy.candidates,
        RUNS,
        STEPS,
        SEED,
        agreed / made,
        wilson(agreed, made).low,
        wrong,
        clopper_pearson(wrong, agreed, 0.05)[1],
        impossible,
    )
