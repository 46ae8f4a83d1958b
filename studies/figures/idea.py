"""The idea of the scheme and of the attack in one picture, drawn from one real step."""

from pathlib import Path
from typing import Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from studies.figures.rows import figure, plain_rows
from wyner.drawing.style import COLOURS

ALPHA: Final = 3.0
"""D_e = ALPHA D_c in the picture: small, so that both sets can be seen."""

Point = tuple[float, float]

TEXTS: Final = (
    (
        "1  Two inputs are offered.",
        "The plant tosses a coin and applies one.\nEach would lead near its own prediction.",
    ),
    (
        "2  The state arrives.",
        "In one small set only: both ends\nknow the coin. That is a key bit.",
    ),
    (
        "3  Eve knows the large sets only.",
        "Both hold the state: Eve cannot tell,\nthe paper says. But one is nearer.",
    ),
)


@figure("idea", "sets", size=(9.0, 3.6))
def draw_idea(figure: Figure, data: Path) -> str:
    """Three panels of one step: what is offered, what both ends see, what Eve sees."""
    rows = plain_rows(data / "sets.csv")
    step = {r["name"]: (r["x_1"], r["x_2"]) for r in rows if r["kind"] == "step"}
    w, centres, state = step["D_c"], (step["c_0"], step["c_1"]), step["x(k+1)"]
    panels = figure.subplots(1, 3, sharex=True, sharey=True)
    for place, (axes, (title, text)) in enumerate(zip(panels, TEXTS, strict=True)):
        axes.set_title(title, loc="left", fontsize=10, fontweight="bold")
        axes.set_xlabel(text, fontsize=9, loc="left")
        axes.set_xticks([])
        axes.set_yticks([])
        axes.grid(visible=False)
        for spine in axes.spines.values():
            spine.set_visible(False)
        for i, c in enumerate(centres):
            if place < 2:
                _box(axes, c, w, 1.0, COLOURS[i], "-")
            if place == 2:
                _box(axes, c, w, ALPHA, COLOURS[i], "--")
                axes.plot([c[0], state[0]], [c[1], state[1]], color=COLOURS[i], lw=0.8)
            axes.plot(*c, marker="+", ms=9, mew=1.6, color=COLOURS[i], ls="none")
            below = (c[0], c[1] - (0.25 if place < 2 else 0.35) * w[1])
            axes.annotate(str(i), below, color=COLOURS[i], ha="center", va="top", fontsize=9)
        if place > 0:
            axes.plot(*state, "k*", ms=11)
    low = min(c[1] for c in centres) - (ALPHA + 0.3) * w[1]
    high = max(c[1] for c in centres) + (ALPHA + 0.3) * w[1]
    panels[0].set_ylim(low, high)
    left = min(c[0] for c in centres) - (ALPHA + 0.3) * w[0]
    right = max(c[0] for c in centres) + (ALPHA + 0.3) * w[0]
    panels[0].set_xlim(left, right)
    return (
        "A step of one run, seed 7, of the scenario sustained. Full: D_c around each prediction. "
        f"Dashed: D_e = {ALPHA:g} D_c. Star: the state."
    )


def _box(axes: Axes, c: Point, w: Point, scale: float, colour: str, style: str) -> None:
    x = [c[0] + s * scale * w[0] for s in (-1, 1, 1, -1, -1)]
    y = [c[1] + s * scale * w[1] for s in (-1, -1, 1, 1, -1)]
    axes.fill(x, y, color=colour, alpha=0.10, lw=0)
    axes.plot(x, y, style, color=colour, lw=1.3)
