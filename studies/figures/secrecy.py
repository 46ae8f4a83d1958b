"""The figure of docs/findings.md of what the paper's eavesdropper gets, and who measures."""

from pathlib import Path
from typing import Any, Final

from matplotlib.figure import Figure

from studies.figures.rows import bars, figure, plain_rows
from studies.secrecy.tables import share_of
from wyner.drawing.style import COLOURS

STYLES: Final[dict[str, dict[str, Any]]] = {
    "set-membership": {"fmt": "o-", "color": "0.5"},
    "nearest-centre": {"fmt": "s-", "color": COLOURS[0]},
}
"""Told apart without colour too."""


@figure("secrecy-alpha", "secrecy-alpha", size=(7.0, 3.8))
def draw_alpha(figure: Figure, data: Path) -> str:
    """Key symbols right against alpha, per eavesdropper: the paper's rule beside the truth."""
    rows = [r for r in plain_rows(data / "secrecy-alpha.csv") if r["tap"] in STYLES]
    axes = figure.subplots()
    alphas = sorted({r["condition"] for r in rows})
    for tap, style in STYLES.items():
        mine = [[r for r in rows if (r["condition"], r["tap"]) == (a, tap)] for a in alphas]
        shares = [share_of(group, "keys_right_reviewed", "keys") for group in mine]
        bars(axes, alphas, shares, 0, mfc=None, ms=5, label=tap, **style)
    axes.axhline(0.5, color="0.6", lw=0.8, ls=":")
    axes.set_xlabel(r"$\alpha$ ($\mathcal{D}_e = \alpha\,\mathcal{D}_c$)")
    axes.set_ylim(0.4, 1.03)
    axes.set_ylabel("agreed key symbols guessed right")
    axes.legend(loc="center right")
    seeds = sorted({r["seed"] for r in rows})
    return (
        f"{len(mine[0])} runs of {rows[0]['steps']} steps each, seeds {seeds[0]} to {seeds[-1]}; "
        "95 % bootstrap intervals over runs"
    )
