"""Figures of the packed alphabets: rates against alpha, the price, codes over blocks."""

import math
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from studies.figures.loop import alpha_of, summaries
from studies.figures.rows import figure, plain_rows, rate_in
from wyner.drawing.style import COLOURS, MARKERS

PAPERS_START = "[4.0,-2.0]"


@figure("signalling-rates", "signalling-rates", "fig7-paper", size=(7.4, 4.6))
def draw_rates(figure: Figure, data: Path) -> str:
    """Bits a step over alpha: the two laws of Fig. 7, either scheme, and packed."""
    rows = plain_rows(data / "signalling-rates.csv")
    axes = figure.subplots()
    paper = [
        s
        for s in summaries(data, "fig7-paper")
        if str(s.first["plant.initial_state"]) == PAPERS_START
    ]
    curves = {
        "paper, switched (50 steps)": [
            (alpha_of(s), s.rate.value * s.first["period_s"]) for s in paper
        ],
        "sustained, switched": _points(rows, law="sustained", scheme="switched"),
        "sustained, pipelined": _points(rows, law="sustained", scheme="pipelined"),
        "packed: certain for every d in $\\mathcal{D}_c$": _points(rows, law="packed"),
    }
    for place, (label, points) in enumerate(curves.items()):
        axes.plot(
            [a for a, _ in points],
            [b for _, b in points],
            marker=MARKERS[place],
            color=COLOURS[place],
            drawstyle="steps-post" if place == 3 else "default",
            label=label,
        )
    alphas = [1.001 + 0.01 * k for k in range(900)]
    long = [math.log2(max(1, math.ceil(a) - 1)) for a in alphas]
    axes.plot(alphas, long, "k:", lw=1, label="supremum of long alphabets, any $d$")
    axes.plot(alphas, [math.log2(a) for a in alphas], "k--", lw=1, label="volume bound")
    axes.set_xlabel(r"$\alpha$ ($\mathcal{D}_e = \alpha\,\mathcal{D}_c$)")
    axes.set_ylabel(rate_in("bit a step"))
    axes.set_title("The paper's plant: the rate by the paper's rule, by law and scheme")
    axes.set_ylim(0, 3.6)
    axes.legend(fontsize=7, loc="upper left")
    r = rows[0]
    widest = max(r["bits_high"] - r["bits_low"] for r in rows)
    return (
        f"{r['runs']} runs of {r['steps']} steps a point, seed {r['seed']}; 95 % bootstrap "
        f"intervals over runs are at most {widest:.3f} wide, less than a mark"
    )


def _points(rows: list[dict[str, Any]], **where: str) -> list[tuple[float, float]]:
    found = [r for r in rows if all(r[key] == value for key, value in where.items())]
    return [(r["alpha"], r["bits_per_step"]) for r in found]
