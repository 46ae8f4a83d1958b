"""The rates at which the shipped loops settle: 10,000 steps on, from x(0) and from the origin.

``python -m studies.settled`` puts the table of the data on the page.
"""

import csv
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Final

from controller_service.laws.registry import cached_design, make_law
from protocol.scenario import Scenario
from protocol.statistics import Interval
from runtime.scenario_file import load_scenario, scenario_of
from runtime.shipped import SCENARIOS
from studies import DATA
from studies.pages import between_marks, markdown_table
from wyner.advice.rate import SEED, START_STEPS, STEPS, long_runs, settled_rate
from wyner.sweeps import SWEEPS
from wyner.sweeps.code import ROOT
from wyner.sweeps.grid import load_sweep, points_of

BURN_IN: Final = 10_000
"""Steps that are left out of each run."""

PAGE: Final = ROOT / "docs" / "findings.md"

LIMITS: Final = ("bits", "bits_low", "bits_high")

STATED: Final = {
    "batch-reactor": "5.65", "double-integrator": "0.0127", "encoder": "4.93",
    "keys": "19.9", "keys-network": "19.9", "network": "2.17", "noisy": "7.92",
    "packed": "19.9", "packed-batch-reactor": "79.7", "packed-double-integrator": "1.99",
    "paper": "0.071", "quadruple-tank": "0.0539", "sustained": "2.28", "watched": "19.9",
    "uniform": "2.30", "truncated Gaussian": "2.03", "sinusoid": "1.79", "constant bias": "0.09",
    "corners of D": "0.88", "corners of D_c": "0.78", "Gaussian, 3 % outside": "2.16",
    "Gaussian, 41 % outside": "1.76",
}  # fmt: skip
"""What version 1.0.0 stated, bit/s: the first 250 or 300 steps from x(0)."""

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


def table(rows: Sequence[dict[str, str]]) -> str:
    """The loops of the page: their rate from both starts, and their last key."""
    lines: list[tuple[str, ...]] = [
        ("loop", "law", "stated before", "from x(0)", "from the origin", "last key")
    ]
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
        lines.append((label, f"`{first['law']}`", STATED.get(name, "-"), *rates, told))
    return markdown_table(lines)


def written(text: str, rows: Sequence[dict[str, str]]) -> str:
    """The page with the table between its marks."""
    return between_marks(text, "settled", table(rows))


if __name__ == "__main__":
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8"), recorded()), encoding="utf-8")
