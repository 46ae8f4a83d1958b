"""The figures of docs/findings.md: rates, agreements, disturbances, price, plants, sets."""

import itertools
import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from protocol.arrays import Array
from studies.figures.rows import (
    Rows,
    bars,
    figure,
    plain_rows,
    rate_in,
)
from wyner.drawing.axes import draw_agreement
from wyner.drawing.axes import draw_sets as draw_outlines
from wyner.drawing.style import COLOURS
from wyner.sweeps.results import Summary, read_rows, summarise


def summaries(data: Path, name: str) -> list[Summary]:
    """The points of a sweep's data file."""
    return summarise(read_rows(data / f"{name}.csv"))


def alpha_of(s: Summary) -> float:
    """The point's alpha."""
    return float(s.first["secrecy.alpha"])


def start_of(s: Summary) -> str:
    """The point's initial state."""
    x = json.loads(s.first["plant.initial_state"])
    return "x(0) = (" + ", ".join(f"{v:g}" for v in x) + ")"


def by(points: Iterable[Summary], key: Callable[[Summary], str]) -> dict[str, list[Summary]]:
    """The points grouped, in order of first appearance."""
    found: dict[str, list[Summary]] = {}
    for s in points:
        found.setdefault(key(s), []).append(s)
    return found


def note_of(points: Sequence[Summary], text: str = "bars and bands") -> str:
    """Runs, steps, seed and interval of a sweep's points."""
    runs = sorted({s.runs for s in points})
    steps = sorted({int(s.first["steps"]) for s in points})
    seeds = sorted({int(s.first["seed"]) for s in points})

    def shown(values: list[int]) -> str:
        return str(values[0]) if len(values) == 1 else f"{values[0]} to {values[-1]}"

    return (
        f"{shown(runs)} runs of {shown(steps)} steps a point, seed {shown(seeds)}; {text}: 95 % "
        "bootstrap intervals over runs"
    )


def curve(
    axes: Axes, points: Sequence[Summary], label: str, place: int, *, marked: bool = False
) -> None:
    """Rate against alpha with its interval."""
    alphas, rates = [alpha_of(s) for s in points], [s.rate for s in points]
    if marked:
        bars(axes, alphas, rates, place, label=label, lw=0.8)
        return
    low, high = [r.low for r in rates], [r.high for r in rates]
    axes.fill_between(alphas, low, high, color=COLOURS[place], alpha=0.2, lw=0)
    axes.plot(alphas, [r.value for r in rates], color=COLOURS[place], label=label, lw=1.4)


@figure("rate-paper", "fig7-paper", "fig7-paper-20", size=(6.4, 4.2))
def draw_paper(figure: Figure, data: Path) -> str:
    """Fig. 7: the rate under the paper's law."""
    many, printed = summaries(data, "fig7-paper"), summaries(data, "fig7-paper-20")
    axes = figure.subplots()
    for place, (start, points) in enumerate(by(many, start_of).items()):
        curve(axes, points, f"{start}, {points[0].runs} runs", place)
    for place, (start, points) in enumerate(by(printed, start_of).items()):
        curve(axes, points, f"{start}, {points[0].runs} runs", place, marked=True)
    axes.set_xlabel(r"$\alpha$ ($\mathcal{D}_e = \alpha\,\mathcal{D}_c$)")
    axes.set_ylabel(rate_in("bit/s"))
    axes.set_title("Law paper: rate against alpha (the paper's Fig. 7)")
    axes.set_ylim(bottom=0)
    axes.legend(loc="upper left")
    return note_of([*many, *printed])


@figure("rate-sustained", "fig7-sustained", "sustained-long", size=(6.4, 4.2))
def draw_sustained(figure: Figure, data: Path) -> str:
    """The rate under the law that keeps talking, with both ceilings."""
    short, long = summaries(data, "fig7-sustained"), summaries(data, "sustained-long")
    axes = figure.subplots()
    for place, (start, points) in enumerate(by(short, start_of).items()):
        curve(axes, points, f"{start}, {points[0].first['steps']} steps", place)
    curve(axes, long, f"{long[0].first['steps']} steps", 3, marked=True)
    alphas, ceiling = [], []
    for s in long:
        p = s.counts["agreements"] / s.counts["tested"]
        alphas.append(alpha_of(s))
        ceiling.append(p / (1 + p) / s.first["period_s"])
    axes.plot(
        alphas, ceiling, "k:", lw=1, label="p / (1 + p) a step, p as measured over the long runs"
    )
    half = 0.5 / long[0].first["period_s"]
    axes.axhline(half, color="k", ls="--", lw=1, label="1/2 bit a step, the scheme's ceiling")
    axes.set_xlabel(r"$\alpha$ ($\mathcal{D}_e = \alpha\,\mathcal{D}_c$)")
    axes.set_ylabel(rate_in("bit/s"))
    axes.set_title("Law sustained: rate against alpha")
    axes.set_ylim(0, half * 1.25)
    axes.legend(loc="upper left", ncols=2, fontsize=7)
    return note_of([*short, *long])


@figure("sets", "sets", size=(9.0, 4.4))
def draw_sets(figure: Figure, data: Path) -> str:
    """Some T_i with trajectories through them; Fig. 4 for one step."""
    rows = plain_rows(data / "sets.csv")
    left, right = figure.subplots(1, 2)
    named = {kind: points(rows, kind) for kind in ("set", "trajectory", "step")}
    outlines = {int(name.removeprefix("T_")): ring for name, ring in named["set"].items()}
    draw_outlines(left, outlines, np.array(list(named["trajectory"].values())))
    for line, name in zip(left.lines[len(outlines) :], named["trajectory"], strict=True):
        law, start = name.split()
        line.set_label(f"law {law}, x₁(0) = {start}")
    left.set_xlim(-3, 7)
    left.set_ylim(-11, 9)
    left.legend(fontsize=7, loc="upper right")
    step = {name: of[0] for name, of in named["step"].items()}
    w, centres = step["D_c"], np.array([step["c_0"], step["c_1"]])
    box = np.array(list(itertools.product((-1, 1), repeat=2))) * w
    draw_agreement(right, centres, step["x(k+1)"], box, 3 * box)
    low, high = centres[:, 1].min() - 3.4 * w[1], centres[:, 1].max() + 5.0 * w[1]
    middle = centres[:, 0].mean()
    right.set_ylim(low, high)
    right.set_xlim(middle - (high - low) / 2, middle + (high - low) / 2)
    right.set_aspect("equal")
    right.legend(fontsize=6.5, loc="upper center", ncols=3, columnspacing=1, handlelength=1.5)
    figure.suptitle(
        "Sets with trajectories through them, and one step of them (the paper's Fig. 4)"
    )
    (at,) = {r["index"] for r in rows if r["kind"] == "step"}
    return f"one run each, seed {rows[0]['seed']}; right: step {at}, law sustained; dashed: α = 3"


def points(rows: Rows, kind: str) -> dict[str, Array]:
    """The points of each name, shape (points, 2)."""
    found: dict[str, list[list[float]]] = {}
    for row in rows:
        if row["kind"] == kind:
            found.setdefault(row["name"], []).append([row["x_1"], row["x_2"]])
    return {name: np.array(of) for name, of in found.items()}
