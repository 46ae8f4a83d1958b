"""The figures of docs/findings.md, and the picture of a secrecy report."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from matplotlib.figure import Figure

from protocol.statistics import Interval
from studies.figures.rows import FigureError, bars, figure, intervals, plain_rows
from studies.registry import Row, recorded
from studies.secrecy.tables import share_of
from wyner.drawing.style import COLOURS, MARKERS
from wyner.sweeps.grid import SweepError

MARKS: Final = {
    "set-membership": ("o", "0.5"),
    "nearest-centre": ("s", COLOURS[0]),
    "list-decoder": ("^", COLOURS[1]),
    "learning": ("D", COLOURS[2]),
    "text": ("*", COLOURS[2]),
    "oracle": ("*", "k"),
}
"""Marker and colour: told apart without colour too."""


def rows_of(study: str, data: Path) -> list[Row]:
    """The rows of a study.

    Raises
    ------
    FigureError
        When they cannot be read.
    """
    try:
        return recorded(f"secrecy-{study}", data)
    except SweepError as error:
        raise FigureError(str(error)) from None


def note_of(rows: Sequence[Row], text: str = "95 % bootstrap intervals over runs") -> str:
    """Runs, steps, seeds and interval."""
    seeds = sorted({int(r["seed"]) for r in rows})
    steps = sorted({int(r["steps"]) for r in rows})
    groups = Counter((r["condition"], r["tap"]) for r in rows)
    fewest, most = min(groups.values()), max(groups.values())
    runs = str(most) if fewest == most else f"{fewest} to {most}"
    return (
        f"{runs} runs of {' or '.join(str(s) for s in steps)} steps each, seeds {seeds[0]} to "
        f"{seeds[-1]}; {text}"
    )


def shares_of(
    rows: Sequence[Row], tap: str, conditions: Sequence[str], right: str, of: str
) -> list[Interval]:
    """What one eavesdropper got under each condition."""
    mine = [r for r in rows if r["tap"] == tap]
    return [share_of([r for r in mine if r["condition"] == c], right, of) for c in conditions]


def heights(shares: Sequence[Interval]) -> tuple[list[float], list[list[float]]]:
    """Values, and how far their intervals reach below and above."""
    values = [s.value for s in shares]
    below = [max(v - s.low, 0.0) for v, s in zip(values, shares, strict=True)]
    above = [max(s.high - v, 0.0) for v, s in zip(values, shares, strict=True)]
    return values, [below, above]


def against_alpha(
    figure: Figure, data: Path, taps: Sequence[str], right: str, of: str, what: str
) -> str:
    """One line an eavesdropper, over the values of alpha; returns the note."""
    rows = [r for r in rows_of("alpha", data) if r["tap"] in taps]
    axes = figure.subplots()
    alphas = sorted({r["condition"] for r in rows}, key=float)
    for tap in taps:
        values, errors = heights(shares_of(rows, tap, alphas, right, of))
        marker, colour = MARKS[tap]
        axes.errorbar([float(a) for a in alphas], values, yerr=errors, marker=marker, color=colour,
                      capsize=2, ms=5, label=tap)  # fmt: skip
    axes.axhline(0.5, color="0.6", lw=0.8, ls=":")
    axes.set_xlabel(r"$\alpha$ ($\mathcal{D}_e = \alpha\,\mathcal{D}_c$)")
    axes.set_ylim(0.4, 1.03)
    axes.set_ylabel(what)
    axes.legend(loc="center right")
    return note_of(rows)


@figure("secrecy-alpha", "secrecy-alpha", size=(7.0, 3.8))
def draw_alpha(figure: Figure, data: Path) -> str:
    """Key symbols right against alpha, per eavesdropper: the paper's rule beside the truth."""
    taps, what = ("set-membership", "nearest-centre"), "agreed key symbols guessed right"
    return against_alpha(figure, data, taps, "keys_right_reviewed", "keys", what)


@figure("secrecy-alpha-bits", "secrecy-alpha", size=(7.0, 3.8))
def draw_alpha_bits(figure: Figure, data: Path) -> str:
    """Message symbols right against alpha: one threshold against all of them."""
    taps = ("set-membership", "nearest-centre", "list-decoder")
    return against_alpha(figure, data, taps, "bits_right", "bits", "message bits right")


@figure("secrecy-learning", "secrecy-learning", size=(7.0, 3.8))
def draw_learning(figure: Figure, data: Path) -> str:
    """When the learner first had the whole message, beside when the plant had it."""
    rows = [r for r in rows_of("learning", data) if int(r["plant_k"]) >= 0]
    conditions = list(dict.fromkeys(r["condition"] for r in rows))
    axes = figure.subplots()
    grid = list(range(0, max(int(r["steps"]) for r in rows) + 1, 10))

    def reached(steps: Sequence[int], k: int) -> float:
        return sum(0 <= step <= k for step in steps) / len(steps)

    for style, condition in zip(("-", "--", "-.", ":"), conditions, strict=True):
        solved = [int(r["solved_k"]) for r in rows if r["condition"] == condition]
        axes.plot(grid, [reached(solved, k) for k in grid], style, color=MARKS["learning"][1],
                  label=f"learning, {condition}")  # fmt: skip
    had = [int(r["plant_k"]) for r in rows if r["condition"] == conditions[0]]
    axes.plot(grid, [reached(had, k) for k in grid], color="k", lw=0.9, label="the plant itself")
    axes.set_xlabel("step k")
    axes.set_ylabel("runs with the whole message")
    axes.set_ylim(0, 1.03)
    axes.legend(loc="upper left")
    return note_of(rows, "every run is counted, 95 % Wilson intervals in the table")


@figure("secrecy-shape", "secrecy-shape", size=(6.4, 3.6))
def draw_shapes(figure: Figure, data: Path) -> str:
    """Keys named right against the shape of D_e, by tap."""
    rows = plain_rows(data / "secrecy-shape.csv")
    axes = figure.subplots()
    for place, tap in enumerate(dict.fromkeys(r["tap"] for r in rows)):
        mine = [r for r in rows if r["tap"] == tap]
        at = [r["width_1"] for r in mine]
        style: dict[str, Any] = {"fmt": "-", "marker": MARKERS[place], "label": tap}
        if place == 0:
            style["mfc"] = None
        bars(axes, at, intervals(mine, "right"), place, **style)
    axes.axhline(0.5, color="0.6", ls=":", lw=1)
    axes.set_xlabel(r"half-width of $\mathcal{D}_e$ in $x_1$ ($x_2$: 0.96; $\mathcal{D}_c$: 0.12)")
    axes.set_ylabel("agreed key symbols guessed right")
    axes.set_title("A D_e of its own shape: who measures in it, and who learns a better one")
    axes.legend(fontsize=7, loc="lower right")
    r = rows[0]
    return (
        f"`packed`, two candidates, every transition agreed; {r['runs']} runs of {r['steps']} "
        f"steps a point, seed {r['seed']}; 95 % normal intervals over runs"
    )
