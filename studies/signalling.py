"""Data of docs/findings.md: rates of every law and scheme, and the price."""

import math
from collections import Counter
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from controller_service.laws.registry import cached_design, make_law
from controller_service.sets.alphabet import line_size
from controller_service.sets.separation import Separation
from controller_service.sets.terminal import feedback_gain
from protocol.arrays import Array
from protocol.scenario import Scenario, parse_scenario
from protocol.statistics import Interval, mean_over_runs, normal_mean
from runtime.scenario_file import scenario_of
from studies.registry import study
from wyner.simulate.engine import Runs, follow, simulate_runs

SEED: Final = 7
RUNS, STEPS = 100, 1000
ALPHAS: Final = (
    1.5,
    2.0,
    2.5,
    2.67,
    3.01,
    3.5,
    4.0,
    4.5,
    5.01,
    5.5,
    6.0,
    6.5,
    7.01,
    8.0,
    9.01,
    10.0,
)
RATE_COLUMNS: Final = (
    "law scheme alpha candidates spacing runs steps seed agreed carried bits_per_step "
    "bits_low bits_high"
)
PRICE_COLUMNS: Final = (
    "law terminal candidates spacing alpha runs steps seed bits_per_step state_cost "
    "state_low state_high input_effort travel travel_low travel_high largest_input kx ku"
)


def changed(name: str, **tables: dict[str, Any]) -> Scenario:
    """A shipped scenario with fields of its tables replaced; None takes one away."""
    data = scenario_of(name).model_dump(exclude_none=True)
    for table, fields in tables.items():
        data[table].update(fields)
        for field in [f for f, value in fields.items() if value is None]:
            del data[table][field]
    return parse_scenario(data, name)


def simulated(scenario: Scenario, *, record: bool = False) -> Runs:
    """Its runs under its own law."""
    law = make_law(scenario, cached_design(scenario))
    return simulate_runs(scenario, law, seed=SEED, runs=range(RUNS), steps=STEPS, record=record)


def _rate(scenario: Scenario, runs: Runs, alpha: float, spacing: float) -> Any:
    size = scenario.secrecy.candidates
    link = follow(runs, [alpha])
    agreed, carried = int(link.agreements.sum()), int(link.message_symbols.sum())
    rate = mean_over_runs(Counter(link.message_symbols[0].tolist())).scaled(math.log2(size) / STEPS)
    return (
        scenario.control.law,
        scenario.secrecy.scheme,
        alpha,
        size,
        spacing,
        RUNS,
        STEPS,
        SEED,
        agreed,
        carried,
        *rate,
    )


@study("signalling-rates", RATE_COLUMNS)
def rate_rows(_: None) -> Iterator[tuple[Any, ...]]:
    """Message bits a step over alpha: `sustained` with either scheme, and `packed`."""
    for scheme in ("switched", "pipelined"):
        scenario = changed("sustained", secrecy={"scheme": scheme})
        runs = simulated(scenario)
        for alpha in ALPHAS:
            yield _rate(scenario, runs, alpha, math.nan)
    base = scenario_of("packed")
    sep = Separation.of(base.B, base.defender.disturbance)
    for alpha in ALPHAS:
        certain = line_size(sep, alpha)
        if certain > 1:
            scenario = changed("packed", secrecy={"alpha": alpha, "candidates": certain})
            yield _rate(scenario, simulated(scenario), alpha, 2.0)


@study("signalling-price", PRICE_COLUMNS)
def price_rows(_: None) -> Iterator[tuple[Any, ...]]:
    """Costs of the loop from the origin, quiet and at every size, with either terminal set."""
    terminals: dict[str, dict[str, Any]] = {
        "regulator, R = 0.005": {},
        "the paper's K": {"gain": [[-13.27, -2.26]], "regulator": None},
    }
    start = {"initial_state": [0.0, 0.0]}
    for name, control in terminals.items():
        quiet = {"law": "sustained", "alphabet": None, "costs": [{"next_state": 1.0}] * 2}
        yield _price(
            name,
            changed("packed", control={**control, **quiet}, secrecy={"candidates": 2}, plant=start),
            math.nan,
        )
        for size, alpha, spacing in (
            (2, 2.0, 1.0),
            (2, 2.34, 1.5),
            (2, 3.01, 2.0),
            (3, 5.01, 2.0),
            (4, 7.01, 2.0),
            (5, 9.01, 2.0),
            (8, 15.01, 2.0),
        ):
            if size > 4 and "gain" in control:
                continue  # the paper's K keeps no set beside five
            scenario = changed(
                "packed",
                control={**control, "alphabet": {"spacing": spacing}},
                secrecy={"candidates": size, "alpha": alpha},
                plant=start,
            )
            yield _price(name, scenario, spacing)


def _price(name: str, scenario: Scenario, spacing: float) -> tuple[Any, ...]:
    runs = simulated(scenario, record=True)
    assert runs.candidates is not None
    size, alpha = scenario.secrecy.candidates, scenario.secrecy.alpha
    u = np.take_along_axis(runs.candidates[:, :, 0], runs.coin[:, None].astype(np.intp), 1)[:, 0]
    A, B, K = np.array(scenario.A), np.array(scenario.B), feedback_gain(scenario)
    kx, ku = dither_price(A, B, K)
    bits = math.log2(size) * float(follow(runs, [alpha]).agreements.sum()) / (RUNS * STEPS)
    return (
        scenario.control.law,
        name,
        size,
        spacing,
        alpha,
        RUNS,
        STEPS,
        SEED,
        0.0 if math.isnan(spacing) else bits,
        *_mean(runs.state_cost / STEPS),
        float(runs.input_effort.mean()) / STEPS,
        *_mean(np.abs(np.diff(u, axis=0)).mean(axis=0)),
        float(np.abs(u).max()),
        kx,
        ku,
    )


def dither_price(A: Array, B: Array, K: Array) -> tuple[float, float]:
    """kx and ku: what dither p of variance 1, in u = K x + p, adds to the means of x'x and u'u.

    Of one input, where no constraint is active.
    """
    from scipy.linalg import solve_discrete_lyapunov

    S = solve_discrete_lyapunov(A + B @ K, B @ B.T)
    return float(np.trace(S)), float(np.trace(K @ S @ K.T)) + 1.0


def _mean(values: Array) -> Interval:
    """Mean over runs with its normal interval."""
    return normal_mean(float(values.sum()), float((values * values).sum()), len(values))
