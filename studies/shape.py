"""Data of docs/findings.md: keys named right where D_e has a shape of its own, by tap."""

from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from controller_service.laws.registry import cached_design, make_law
from protocol.agreement import NO_SYMBOL
from protocol.statistics import normal_mean
from studies.registry import study
from studies.signalling import changed
from tap_service.eavesdroppers import named
from wyner.simulate.engine import simulate_runs, transfer
from wyner.simulate.engine.taps import transcript

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
    for name in TAPS:
        shares, whole, agreed = [], 0, 0
        for place in range(RUNS):
            tap = named(name)(scenario.knowledge())
            live = [tap.observe(t).best for t in transcript(runs, link, place)]
            late = {g.k: g.best for g in (*tap.final_guesses, *tap.review())}
            best = {**dict(enumerate(live)), **late}
            keys = link.agreed[:, place].tolist()
            steps = [k for k, key in enumerate(keys) if key != NO_SYMBOL]
            shares.append(float(np.mean([best[k] == keys[k] for k in steps])))
            whole += MESSAGE in tap.belief().whole
            agreed += len(steps)
        values = np.array(shares)
        mean = normal_mean(float(values.sum()), float((values**2).sum()), RUNS)
        yield width, 0.96, name, RUNS, STEPS, SEED, agreed, *mean, whole
