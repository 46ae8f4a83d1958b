"""How many steps until Eve has the model, beside one who is told every coin.

The literature on encrypted control measures secrecy by the samples that least squares need to know
the plant (sample identifying complexity: Teranishi and Kogiso, arXiv 2303.13059, abstract). The
yardstick here is the same least squares on the inputs that were applied; Eve does not know which
candidate that was. Both count as having the model from the first fit on after which the error of
(A, B), relative in the Frobenius norm, stays below a share.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

import numpy as np

from controller_service.laws.registry import cached_design, make_law
from protocol.arrays import Array, Integers
from runtime.scenario_file import scenario_of
from studies.registry import Lines, Row, study, table
from tap_service.inference.identification import identify
from wyner.simulate.engine import simulate_runs

RUNS, STEPS, SEED = 8, 3000, 2813
SHARES: Final = (0.1, 0.03)
SCENARIOS: Final = ("sustained", "packed", "khepera", "stochastic")

FITS: Final = tuple(round(8 * 1.25**i) for i in range(27) if 8 * 1.25**i <= STEPS)
"""Steps after which each fits anew."""

COLUMNS: Final = "scenario share runs steps seed eve eve_low eve_high told told_low told_high"

Fit = Callable[[Array, Array, Array, Integers], Array]
"""Takes x, the candidates, x_next and the coins; (A B)."""


def by_eve(x: Array, u: Array, after: Array, _: Integers) -> Array:
    """As `learning` identifies."""
    fit = identify(x, u, after)
    return np.hstack([fit.A, fit.B])


def by_told(x: Array, u: Array, after: Array, coins: Integers) -> Array:
    """Least squares on the inputs that were applied."""
    phi = np.hstack([x, u[np.arange(len(x)), coins], np.ones((len(x), 1))])
    return np.asarray(np.linalg.lstsq(phi, after, rcond=None)[0][:-1].T, dtype=float)


@study("yardstick", COLUMNS, lambda: SCENARIOS)
def yardstick_rows(name: str) -> Iterator[tuple[Any, ...]]:
    """A row a share: the median of the runs, and their quartiles; more than STEPS for never."""
    scenario = scenario_of(name)
    law = make_law(scenario, cached_design(scenario))
    runs = simulate_runs(scenario, law, seed=SEED, runs=range(RUNS), steps=STEPS, record=True)
    assert runs.x is not None
    assert runs.candidates is not None
    true = np.hstack([np.array(scenario.A), np.array(scenario.B)])
    errors = np.empty((2, len(FITS), RUNS))
    for r in range(RUNS):
        x, u = runs.x[:, :, r], runs.candidates[..., r]
        for i, heard in enumerate(FITS):
            for which, fit in enumerate((by_eve, by_told)):
                found = fit(x[:heard], u[:heard], x[1 : heard + 1], runs.coin[:heard, r])
                errors[which, i, r] = np.linalg.norm(found - true) / np.linalg.norm(true)
    for share in SHARES:
        until = [had_from(errors[which] > share) for which in (0, 1)]
        yield (
            name, share, RUNS, STEPS, SEED,
            *(float(v) for steps in until for v in np.quantile(steps, [0.5, 0.25, 0.75])),
        )  # fmt: skip


def had_from(above: Any) -> Array:
    """Of each run the first fit from which on none is above; STEPS + 1 where the last one is."""
    ends = np.array([*FITS, STEPS + 1], dtype=float)
    last = np.array([np.flatnonzero(column).max(initial=-1) for column in above.T])
    out: Array = ends[last + 1]
    return out


@table("yardstick", "findings", "yardstick")
def shown(rows: Sequence[Row]) -> Lines:
    """A line a scenario and share."""
    lines: list[tuple[str, ...]] = [
        ("scenario", "error of (A, B) below", "Eve, steps", "told every coin, steps")
    ]
    for row in rows:
        hers, told = (
            f"{_steps(row[who])} [{_steps(row[f'{who}_low'])}, {_steps(row[f'{who}_high'])}]"
            for who in ("eve", "told")
        )
        lines.append((f"`{row['scenario']}`", f"{100 * float(row['share']):g} %", hers, told))
    return lines


def _steps(value: str) -> str:
    return f"over {STEPS}" if float(value) > STEPS else f"{float(value):.0f}"
