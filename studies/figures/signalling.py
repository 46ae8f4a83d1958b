"""Figures of the packed alphabets: rates against alpha, the price, codes over blocks."""

import math
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from protocol.statistics import Interval
from studies.figures.loop import alpha_of, summaries
from studies.figures.rows import band, columns, figure, plain_rows, rate_in
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


@figure("signalling-price", "signalling-price", size=(8.0, 3.8))
def draw_price(figure: Figure, data: Path) -> str:
    """State cost and actuator travel against the bits that count by the paper's rule."""
    rows = plain_rows(data / "signalling-price.csv")
    left, right = figure.subplots(1, 2)
    for place, name in enumerate(dict.fromkeys(r["terminal"] for r in rows)):
        mine = [r for r in rows if r["terminal"] == name]
        for axes, key, low, high in (
            (left, "state_cost", "state_low", "state_high"),
            (right, "travel", "travel_low", "travel_high"),
        ):
            bits, value = columns(mine, "bits_per_step", key)
            limits = zip(value, *columns(mine, low, high), strict=True)
            band(axes, bits, [Interval(*v) for v in limits], place)
            label = f"$\\mathcal{{T}}_0$ by {name}"
            axes.plot(bits, value, marker=MARKERS[place], color=COLOURS[place], label=label)
    left.set_ylabel(r"mean $|x(k+1)|^2$")
    right.set_ylabel(r"mean $|u(k+1) - u(k)|$")
    for axes in (left, right):
        axes.set_xlabel(rate_in("bit a step"))
        axes.set_ylim(bottom=0)
    left.legend(fontsize=7)
    figure.suptitle("The price of a packed alphabet, from the origin")
    r = rows[0]
    return (
        f"{r['runs']} runs of {r['steps']} steps a point, seed {r['seed']}; bands: 95 % normal "
        "intervals over runs"
    )


@figure("block-codes", "block-codes", size=(6.8, 4.2))
def draw_blocks(figure: Figure, data: Path) -> str:
    """The chained code over more and more steps, up to the volume bound, and the void beyond."""
    rows = plain_rows(data / "block-codes.csv")
    axes = figure.subplots()
    for place, steps in enumerate(dict.fromkeys(r["steps"] for r in rows)):
        mine = [r for r in rows if r["steps"] == steps]
        label = f"chained over {steps} step{'s' if steps > 1 else ''}"
        curve = columns(mine, "alpha", "bits_per_step")
        axes.step(*curve, where="post", lw=1.2, color=COLOURS[place], label=label)
    first = [r for r in rows if r["steps"] == rows[0]["steps"]]
    alphas, bound, finite = columns(first, "alpha", "volume_bound", "finite_bits")
    axes.plot(alphas, bound, "k--", lw=1, label=r"volume bound $\log_2\alpha$")
    label = "finite offers, certain at their ends too"
    axes.step(alphas, finite, "k:", where="post", lw=1, label=label)
    axes.set_xlabel(r"$\alpha$ ($\mathcal{D}_e = \alpha\,\mathcal{D}_c$)")
    axes.set_ylabel(rate_in("bit a step"))
    axes.set_title("Keys of the applied inputs: the limit, and codes that reach it")
    axes.set_ylim(0, 3.3)
    axes.legend(fontsize=7, loc="upper left")
    return (
        "Exact, one input. Where a key may depend on x(k+1) the same rule allows any number of "
        "bits at every alpha above 1"
    )
