"""Data of docs/findings.md: keys named right where D_e has a shape of its own, by tap."""

from collections.abc import Iterator, Sequence
from typing import Any, Final

from controller_service.laws.registry import cached_design, make_law
from protocol.statistics import normal_mean
from studies.listeners import heard
from studies.registry import Lines, Row, interval_of, study, table
from studies.signalling import changed
from tap_service.capture.channel import View
from wyner.simulate.engine import simulate_runs, transfer

SEED: Final = 7
RUNS, STEPS = 10, 600
TAPS: Final = ("nearest-centre", "learning", "text")
WIDTHS: Final = (0.96, 0.48, 0.36, 0.24, 0.18, 0.13)
"""Of D_e in x_1, D_c has 0.12; in x_2 it is 0.96 throughout."""
NEARLY_TWO: Final = 1.9999
"""With a D_e as narrow as 0.13 no alphabet is certain for every d in D_c; all agree for D."""

COLUMNS: Final = "width_1 width_2 tap runs steps seed agreed right right_low right_high whole"
MESSAGE: Final = b"We sail at dawn."


@study("secrecy-shape", COLUMNS, lambda: WIDTHS)
def shape_rows(width: float) -> Iterator[tuple[Any, ...]]:
    """`packed` with two candidates, D_c = (0.12, 0.12): every transition agrees."""
    scenario = changed(
        "packed",
        secrecy={
            "alpha": 1.0,
            "candidates": 2,
            "disturbance": {"half_widths": [width, 0.96]},
        },
        control={"alphabet": {"spacing": NEARLY_TWO}},
    )
    law = make_law(scenario, cached_design(scenario))
    runs = simulate_runs(scenario, law, seed=SEED, runs=range(RUNS), steps=STEPS, record=True)
    link = transfer(runs, payloads=[MESSAGE])
    counts = [heard(TAPS, (runs, link), View(), place) for place in range(RUNS)]
    for name, mine in zip(TAPS, zip(*counts, strict=True), strict=True):
        shares = [one.later / one.keys for one in mine]
        mean = normal_mean(sum(shares), sum(share**2 for share in shares), RUNS)
        agreed, whole = sum(one.keys for one in mine), sum(one.read for one in mine)
        yield width, 0.96, name, RUNS, STEPS, SEED, agreed, *mean, whole


@table("secrecy-shape", "findings", "secrecy-shape")
def shown(rows: Sequence[Row]) -> Lines:
    """Keys named right in %: half-widths of D_e in x_1 down, eavesdroppers across."""
    lines: list[tuple[str, ...]] = [("D_e in x_1", *(f"`{tap}`" for tap in TAPS))]
    for width in dict.fromkeys(row["width_1"] for row in rows):
        mine = {row["tap"]: row for row in rows if row["width_1"] == width}
        lines.append((width, *(interval_of(mine[tap], "right", 100).text(".1f") for tap in TAPS)))
    return lines
