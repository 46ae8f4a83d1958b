"""Figures of what is left of the coins to a tap who watches through noise."""

from pathlib import Path

from matplotlib.figure import Figure

from protocol.statistics import normal
from studies.figures.rows import bars, figure, plain_rows
from wyner.drawing.style import COLOURS


@figure("noise-bound", "noise-bound", size=(8.0, 4.0))
def draw_bound(figure: Figure, data: Path) -> str:
    """Bits left of a coin against Eve's noise: bound, taps and claim; and the law as a lever."""
    rows = plain_rows(data / "noise-bound.csv")
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    mine = [r for r in rows if r["part"] == "noise"]
    proved = [r for r in mine if r["tap"] == "any, proved"]
    left.axhline(proved[0]["claimed"], color="0.4", ls="--", lw=1, label="claimed by the rule")
    for place, tap in enumerate(dict.fromkeys(r["tap"] for r in mine)):
        own = [r for r in mine if r["tap"] == tap]
        x, y = [r["ratio"] for r in own], [r["bits"] for r in own]
        if tap == "any, proved":
            left.plot(x, y, color=COLOURS[0], label="any tap, proved")
            left.fill_between(x, y, color=COLOURS[0], alpha=0.12, lw=0)
            continue
        bars(left, x, [normal(r["bits"], r["error"]) for r in own], place, label=tap)
    left.set_xlabel("Eve's noise over the half-width of $\\mathcal{D}_c$")
    left.set_ylabel("bits left of a coin")
    left.set_ylim(bottom=0)
    left.legend(fontsize=7, loc="lower right")
    lever = [r for r in rows if r["part"] == "law"]
    right.semilogx([r["weight"] for r in lever], [r["bits"] for r in lever], "o-", color=COLOURS[0])
    for r in lever:
        right.annotate(
            f"{r['gain']:.3g}",
            (r["weight"], r["bits"]),
            textcoords="offset points",
            xytext=(3, 4),
            fontsize=6.5,
        )
    right.set_xlabel("weight of the input (beside: gain g)")
    right.set_ylabel("bits left at least, Eve's noise 1 half-width")
    right.set_ylim(bottom=0)
    figure.suptitle("Watched through noise: the proof below, taps above, the claim flat")
    blocks = next(r for r in mine if r["tap"] == "told every d")
    heard = next(r for r in mine if r["tap"] == "text")
    return (
        f"The paper's plant, u = K x + p. {blocks['runs']} blocks of {blocks['steps']} coins; "
        f"text: {heard['runs']} runs of {heard['steps']} steps; seed {heard['seed']}; "
        "95 % normal intervals"
    )
