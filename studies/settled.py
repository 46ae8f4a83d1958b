"""The rates at which the shipped loops settle: 10,000 steps on, from x(0) and from the origin."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Final

from controller_service.laws.registry import cached_design, make_law
from protocol.scenario import Scenario
from protocol.statistics import Interval
from runtime.scenario_file import load_scenario, scenario_of
from runtime.shipped import SCENARIOS
from studies.registry import Lines, Row, study, table
from wyner.advice.rate import SEED, START_STEPS, STEPS, long_runs, settled_rate
from wyner.sweeps import SWEEPS
from wyner.sweeps.grid import load_sweep, points_of

BURN_IN: Final = 10_000
"""Steps that are left out of each run."""

LIMITS: Final = ("bits", "bits_low", "bits_high")

PLANTS: Final = ("sustained", "double-integrator", "quadruple-tank", "batch-reactor")
ALPHAS: Final = tuple(i / 2 for i in range(3, 17))

COLUMNS: Final = (
    "group name law alpha period_s start runs burn_in steps seed agreed agreed_low "
    "agreed_high bits bits_low bits_high last_key start_steps start_bits"
)
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


def loops() -> Iterator[tuple[str, str]]:
    """Each shipped scenario that can be simulated, each disturbance, and each plant."""
    for path in sorted(SCENARIOS.glob("*.toml")):
        scenario = load_scenario(path)
        if scenario.plant.kind == "linear" and scenario.plant.disturbance.enters != "input":
            yield "scenario", path.stem
    for variant in _disturbances():
        yield "disturbance", variant
    for name in PLANTS:
        yield "plant", name


def _disturbances() -> dict[str, Scenario]:
    file = SWEEPS / "disturbances.toml"
    points = points_of(load_sweep(file), file.parent)
    return {p.variant: p.scenario for p in points if p.scenario.secrecy.alpha == max(ALPHAS)}


@study("settled", COLUMNS, loops)
def settled_rows(loop: tuple[str, str]) -> Iterator[Any]:
    """Of a loop, at its own alpha or at each."""
    group, name = loop
    scenario = _disturbances()[name] if group == "disturbance" else scenario_of(name)
    alphas = {"scenario": [scenario.secrecy.alpha], "disturbance": [max(ALPHAS)]}
    yield from rows_of(group, name, scenario, alphas.get(group, ALPHAS))


@table("settled", "findings", "settled")
def shown(rows: Sequence[Row]) -> Lines:
    """The loops of the page: their rate from both starts, and their last key."""
    lines: list[tuple[str, ...]] = [("loop", "law", "from x(0)", "from the origin", "last key")]
    found: dict[tuple[str, str], dict[str, dict[str, str]]] = {}
    for row in rows:
        if row["group"] != "plant":
            found.setdefault((row["group"], row["name"]), {})[row["start"]] = row
    for (group, name), starts in found.items():
        first = next(iter(starts.values()))
        rates = []
        for start in ("x(0)", "origin"):
            of = starts.get(start)
            bits = None if of is None else [float(of[key]) for key in LIMITS]
            T = float(first["period_s"])
            rates.append("-" if bits is None else Interval(*bits).scaled(1 / T).text(".3g"))
        last = max((int(row["last_key"]) for row in starts.values() if row["last_key"]), default=-1)
        end = int(first["burn_in"]) + int(first["steps"])
        quiet = not any(float(row["bits"]) for row in starts.values())
        told = f"step {last}" if quiet and last >= 0 else ("none" if quiet else f"goes on to {end}")
        label = f"scenario `{name}`" if group == "scenario" else f"disturbance: {name}"
        lines.append((label, f"`{first['law']}`", *rates, told))
    return lines
