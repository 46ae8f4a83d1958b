"""The figures of docs/findings.md."""

import math
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from protocol.statistics import Interval, wilson
from studies.figures.rows import bars, figure, plain_rows

SHOWN_STEPS = 12

LINES = {
    ("keyed-coin", "secret"): "key that is secret",
    ("keyed-coin", "false claim"): "key that Eve has",
    ("residual", "nobody"): "no key",
}


@figure("undetected", "attacks", size=(6.4, 3.8))
def draw_undetected(figure: Figure, data: Path) -> str:
    """Share of attacked runs without an alarm, by steps since the onset."""
    rows = plain_rows(data / "attacks.csv")
    axes = figure.subplots()
    steps = np.arange(1, SHOWN_STEPS + 1)
    runs = seed = size = 0
    for place, (which, label) in enumerate(LINES.items()):
        (row,) = (
            r
            for r in rows
            if r["group"] == "key" and r["attack"] == "ghost" and (r["defence"], r["key"]) == which
        )
        left = [int(n) for n in row["unseen"].split()]
        runs, seed, size = row["runs"], row["seed"], row["M"]
        found = [wilson(left[n], runs) for n in steps]
        shown = [f if f.value > 0 else Interval(math.nan) for f in found]
        bars(axes, (steps + 0.15 * max(0, place - 1)).tolist(), shown, place, label=label)
    axes.plot(steps, float(size) ** -steps, color="0.4", ls="--", lw=1, label="$M^{-n}$")
    axes.set_yscale("log")
    axes.set_ylim(2e-5, 2)
    axes.set_xlabel("attacked steps n")
    axes.set_ylabel("share of runs without an alarm")
    axes.legend(loc="center right")
    return (
        f"The paper's plant, M = {size}, a ghost at the sensor. {runs} runs a line, seed {seed}; "
        "95 % Wilson intervals"
    )
