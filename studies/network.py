"""What a network costs a loop: control cost and message rate against losses and delays."""

from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from controller_service.laws.registry import cached_design, make_law
from protocol.agreement import NO_SYMBOL
from protocol.arrays import Array
from protocol.scenario import Scenario, parse_scenario
from protocol.statistics import Interval, normal_mean
from runtime.scenario_file import load_scenario
from runtime.shipped import SCENARIOS
from studies.registry import study
from wyner.simulate.engine import simulate_runs, transfer

RUNS, STEPS = 100, 500
FIRST_SEED: Final = {"loss": 100, "delay": 200}
"""Of the first value; each has draws of its own, the same for all fallbacks."""

FALLBACKS: Final = ("hold", "zero", "regulator")
LOSSES: Final = (0.0, 0.2, 0.4, 0.5, 0.6, 0.7)
"""Probability that a message is lost, the same both ways."""
ROUND_TRIPS: Final = (0.2, 0.6, 0.8, 1.0, 1.2)
"""Mean round trip in periods; each way takes half of it, with half of that as its deviation."""

COLUMNS: Final = (
    "part value fallback runs steps seed missed missed_low missed_high "
    "cost cost_low cost_high bits_per_second bits_per_second_low bits_per_second_high"
)


def networked(base: Scenario, part: str, value: float, fallback: str) -> Scenario:
    """The scenario behind a network that loses, or delays, both ways alike."""
    way: dict[str, Any] = {"loss": value}
    if part == "delay":
        mean = value * base.plant.period_s / 2
        way = {"delay": "gamma", "delay_s": mean, "jitter_s": mean / 2}
    data = base.model_dump(mode="json", exclude_none=True)
    data["network"] = {"to_plant": way, "to_controller": way}
    data["link"] |= {"fallback": fallback}
    return parse_scenario(data, f"{part} {value:g}")


def _mean(values: Array) -> Interval:
    return normal_mean(float(values.sum()), float((values * values).sum()), len(values))


def points() -> Iterator[tuple[str, float, int]]:
    """Each loss and each delay, with the seed of its draws."""
    for part, values in (("loss", LOSSES), ("delay", ROUND_TRIPS)):
        for seed, value in enumerate(values, start=FIRST_SEED[part]):
            yield part, value, seed


@study("network", COLUMNS, points)
def network_rows(point: tuple[str, float, int]) -> Iterator[tuple[Any, ...]]:
    """Missed steps, control cost and rate at a loss or a delay, for each fallback."""
    base = load_scenario(SCENARIOS / "sustained.toml")
    law = make_law(base, cached_design(base))
    part, value, seed = point
    for fallback in FALLBACKS:
        scenario = networked(base, part, value, fallback)
        runs = simulate_runs(scenario, law, seed=seed, runs=range(RUNS), steps=STEPS)
        carried = (transfer(runs).message_symbol != NO_SYMBOL).sum(axis=0)
        bits = float(np.log2(scenario.secrecy.candidates))
        rate = carried * bits / (STEPS * scenario.plant.period_s)
        yield (
            part,
            value,
            fallback,
            RUNS,
            STEPS,
            seed,
            *_mean(runs.missed_share),
            *_mean(runs.mean_cost),
            *_mean(rate),
        )
