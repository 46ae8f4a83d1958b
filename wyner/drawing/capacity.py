"""The figure of `wyner design --alphas`."""

import math
from typing import Any

from matplotlib.figure import Figure

from wyner.drawing.style import COLOURS


def draw_table(figure: Figure, table: dict[str, Any]) -> None:
    """What `wyner design --alphas` prints, as curves over alpha."""
    axes = figure.subplots()
    rows = table["alphas"]
    alphas = [row["alpha"] for row in rows]
    curves = [
        ("certain, within U and control's ceiling", "bits_per_step", "-"),
        ("long alphabets, certain but at their ends", "long_alphabets_bits", ":"),
        ("volume bound of any fixed offsets", "volume_bits", "--"),
    ]
    for place, (label, key, style) in enumerate(curves):
        if rows[0][key] is not None:
            axes.step(
                alphas,
                [row[key] for row in rows],
                style,
                where="post",
                color=COLOURS[place],
                label=label,
            )
    axes.plot(
        alphas,
        [math.log2(row["bound_candidates"]) for row in rows],
        "^",
        color=COLOURS[3],
        mfc="none",
        label="no alphabet is larger",
    )
    if rows[0]["bet"] is not None:
        bits = [row["bet"]["bits"] for row in rows]
        axes.plot(alphas, bits, "o", color=COLOURS[4], label="best bet on the plant's own law of d")
    axes.set_xlabel(r"$\alpha$ ($\mathcal{D}_e = \alpha\,\mathcal{D}_c$)")
    axes.set_ylabel("bits a step by the paper's rule")
    axes.set_title(f"{table['scenario']}: what its inputs can carry; true secrecy 0")
    axes.set_ylim(bottom=0)
    axes.legend(loc="upper left", fontsize=7)
