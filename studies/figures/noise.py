"""Figures of what is left of the coins to a tap who watches through noise."""

from pathlib import Path

from matplotlib.figure import Figure

from protocol.statistics import normal
from studies.figures.rows import bars, figure, plain_rows
from wyner.drawing.style import COLOURS


@figure("noise-bound", "noise-bound", size=(6.4, 4.0))
def draw_bound(figure: Figure, data: Path) -> str:
    """Bits left of a coin against Eve's noise: bound, taps and claim."""
    rows = plain_rows(data / "noise-bound.csv")
    axes = figure.subplots()
    proved = [r for r in rows if r["tap"] == "any, proved"]
    axes.axhline(proved[0]["claimed"], color="0.4", ls="--", lw=1, label="claimed by the rule")
    for place, tap in enumerate(dict.fromkeys(r["tap"] for r in rows)):
        own = [r for r in rows if r["tap"] == tap]
        x, y = [r["ratio"] for r in own], [r["bits"] for r in own]
        if tap == "any, proved":
            axes.plot(x, y, color=COLOURS[0], label="any tap, proved")
            axes.fill_between(x, y, color=COLOURS[0], alpha=0.12, lw=0)
            continue
        bars(axes, x, [normal(r["bits"], r["error"]) for r in own], place, label=tap)
    axes.set_xlabel("Eve's noise over the half-width of $\\mathcal{D}_c$")
    axes.set_ylabel("bits left of a coin")
    axes.set_ylim(bottom=0)
    axes.legend(fontsize=7, loc="lower right")
    axes.set_title("Watched through noise: the proof below, taps above, the claim flat")
    blocks = next(r for r in rows if r["tap"] == "told every d")
    heard = next(r for r in rows if r["tap"] == "text")
    return (
        f"The paper's plant, u = K x + p. {blocks['runs']} blocks of {blocks['steps']} coins; "
        f"text: {heard['runs']} runs of {heard['steps']} steps; seed {heard['seed']}; "
        "95 % normal intervals"
    )
