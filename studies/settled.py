"""The rates at which the shipped loops settle: 10,000 steps on, from x(0) and from the origin.

``python -m studies.settled`` measures them and puts the table on the page.
"""

import csv
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Final

from controller_service.laws.registry import cached_design, make_law
from protocol.scenario import Scenario
from runtime.scenario_file import load_scenario, scenario_of
from runtime.shipped import SCENARIOS
from studies import DATA
from wyner.advice.rate import SEED, START_STEPS, STEPS, long_runs, settled_rate
from wyner.sweeps import SWEEPS
from wyner.sweeps.grid import load_sweep, points_of

BURN_IN: Final = 10_000
"""Steps that are left out of each run."""

PLANTS: Final = ("sustained", "double-integrator", "quadruple-tank", "batch-reactor")
ALPHAS: Final = tuple(i / 2 for i in range(3, 17))

COLUMNS: Final = (
    "group", "name", "law", "alpha", "period_s", "start", "runs", "burn_in", "steps", "seed",
    "agreed", "agreed_low", "agreed_high", "bits", "bits_low", "bits_high", "last_key",
    "start_steps", "start_bits",
)  # fmt: skip
"""``bits`` are message bits a step, ``start_bits`` those of the first ``start_steps``."""


def rows_of(group: str, name: str, scenario: Scenario, alphas: Sequence[float]) -> Iterator[Any]:
    """A row an alpha and start: neither law nor coin depends on alpha."""
    law = make_law(scenario, cached_design(scenario))
    parts = long_runs(scenario, law, burn_in=BURN_IN)
    starts = ("x(0)", "origin") if len(parts) > 1 else ("origin",)
    for alpha in alphas:
        secrecy = scenario.secrecy.model_copy(update={"alpha": alpha})
        judged = scenario.model_copy(update={"secrecy": secrecy})
        for start, runs in zip(starts, parts, strict=True):
            rate = settled_rate([replace(runs, scenario=judged)], BURN_IN)
            T, settled = scenario.plant.period_s, rate.settled
            yield (
                group, name, scenario.control.law, alpha, T, start, settled.runs, BURN_IN, STEPS,
                SEED, *settled.agreed, *settled.bits_per_second.scaled(T), rate.last_key,
                START_STEPS, rate.start.bits_per_second.value * T,
            )  # fmt: skip


def settled_rows() -> Iterator[Any]:
    """Of each shipped scenario that can be simulated, each disturbance, and each alpha."""
    for path in sorted(SCENARIOS.glob("*.toml")):
        scenario = load_scenario(path)
        if scenario.plant.kind == "linear" and scenario.plant.disturbance.enters != "input":
            yield from rows_of("scenario", path.stem, scenario, [scenario.secrecy.alpha])
    file = SWEEPS / "disturbances.toml"
    for point in points_of(load_sweep(file), file.parent):
        if point.scenario.secrecy.alpha == max(ALPHAS):
            yield from rows_of("disturbance", point.variant, point.scenario, [max(ALPHAS)])
    for name in PLANTS:
        yield from rows_of("plant", name, scenario_of(name), ALPHAS)


def recorded() -> list[dict[str, str]]:
    """The rows of the data file."""
    with (DATA / "settled.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))
