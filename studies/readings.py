"""What noise of the plant's own sensors leaves: candidates, keys, and the eavesdroppers."""

from collections.abc import Iterator, Sequence
from typing import Any, Final

from controller_service.laws.base import CandidateLaw
from controller_service.laws.registry import make_law, synthesise
from controller_service.sets.design import SynthesisError
from protocol.agreement import NO_SYMBOL
from protocol.scenario import Scenario, parse_scenario
from protocol.statistics import wilson
from runtime.scenario_file import load_scenario
from runtime.shipped import SCENARIOS
from studies.listeners import Counts, heard, one_run, told
from studies.registry import Lines, Row, interval_of, study, table
from tap_service.capture.channel import View
from wyner.simulate.engine import simulate_runs

SHARES: Final = (0.05, 0.2, 0.3, 0.5)
"""Half-width of the noise over that of D_c, in each coordinate."""
RUNS, STEPS, SEED = 20, 500, 7
HEARD: Final = 10
"""So many of the runs are listened to."""

MESSAGE: Final = b"We sail at dawn."
TAPS: Final = ("set-membership", "nearest-centre", "list-decoder", "learning", "text")
SHOWN: Final = ("nearest-centre", "list-decoder", "learning", "text")
"""Those of the page's table."""

COLUMNS: Final = (
    "share candidates runs steps seed agreed agreed_low wrong impossible tap heard_runs "
    "keys_of keys keys_low keys_high delivered read read_low read_high"
)


def noisy(share: float, candidates: int) -> Scenario:
    """The shipped scenario ``noisy`` with d in the corners of D_c, and n in those of N."""
    base = load_scenario(SCENARIOS / "noisy.toml")
    widths = base.defender.disturbance.half_widths
    assert widths is not None
    N = [share * w for w in widths]
    data = base.model_dump(mode="json", exclude_none=True)
    data["plant"]["disturbance"] = {"kind": "corners", "half_widths": list(widths)}
    data["plant"]["noise"] = {"kind": "corners", "half_widths": N}
    data["defender"]["noise"] = {"half_widths": N}
    data["secrecy"]["candidates"] = candidates
    return parse_scenario(data, f"noise {share:g}")


def largest(share: float) -> tuple[Scenario, CandidateLaw]:
    """The scenario with as many candidates as the rule allows beside this noise."""
    for candidates in range(8, 1, -1):
        scenario = noisy(share, candidates)
        try:
            return scenario, make_law(scenario, synthesise(scenario))
        except SynthesisError:
            continue
    raise SynthesisError(f"defender.noise: {share:g} of D_c leaves no two candidates")


@study("readings", COLUMNS, lambda: SHARES)
def reading_rows(share: float) -> Iterator[tuple[Any, ...]]:
    """One row an eavesdropper."""
    scenario, law = largest(share)
    runs = simulate_runs(scenario, law, seed=SEED, runs=range(RUNS), steps=STEPS)
    possible = runs.largest <= scenario.secrecy.alpha
    agreed = possible & (runs.symbol != NO_SYMBOL)
    count = int(agreed.sum())
    by_tap = zip(*(_heard(share, run) for run in range(HEARD)), strict=True)
    for tap, counts in zip(TAPS, by_tap, strict=True):
        yield (
            share, scenario.secrecy.candidates, RUNS, STEPS, SEED,
            count / agreed.size, wilson(count, agreed.size).low,
            int((agreed & (runs.symbol != runs.coin)).sum()), int((~possible).sum()),
            tap, HEARD, *told(counts),
        )  # fmt: skip


def _heard(share: float, run: int) -> list[Counts]:
    """What each eavesdropper makes of a run."""
    scenario, law = largest(share)
    made = one_run(scenario, run, seed=SEED, steps=STEPS, payload=MESSAGE, law=law)
    return heard(TAPS, made, View())


@table("readings", "concepts", "readings")
def shown(rows: Sequence[Row]) -> Lines:
    """The table of docs/concepts.md: a line a share of noise."""
    lines = [("noise over D_c", "M", "agreed, wrong", *(f"`{tap}`" for tap in SHOWN))]
    for share in SHARES:
        mine = {row["tap"]: row for row in rows if float(row["share"]) == share}
        first = mine[SHOWN[0]]
        steps = int(first["runs"]) * int(first["steps"])
        agreed = round(float(first["agreed"]) * steps)
        lines.append(
            (
                f"{100 * share:.0f} %",
                first["candidates"],
                f"{agreed:,} of {steps:,}, {first['wrong']}",
                *(_cell(mine[tap]) for tap in SHOWN),
            )
        )
    return lines


def _cell(row: Row) -> str:
    keys = interval_of(row, "keys", 100)
    read = round(float(row["read"]) * int(row["delivered"]))
    return f"{keys.value:.3g} [{keys.low:.3g}, {keys.high:.3g}]; {read} of {row['delivered']}"
