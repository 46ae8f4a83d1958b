"""The figure of docs/keys.md."""

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from protocol.statistics import wilson
from studies.figures.rows import bars, figure, plain_rows


@figure("key-controls", "key-controls", size=(7.4, 4.6))
def draw_controls(figure: Figure, data: Path) -> str:
    """Blocks that Eve breaks, with each rule broken and kept."""
    rows = plain_rows(data / "key-controls.csv")
    controls = list(dict.fromkeys(r["control"] for r in rows))
    axes = figure.subplots()
    for i, (rule, marker) in enumerate((("broken", "s"), ("kept", "o"))):
        for place, control in enumerate(controls):
            row = next(r for r in rows if (r["control"], r["rule"]) == (control, rule))
            found = wilson(row["breached"], row["blocks"])
            share = row["breached"] / row["blocks"]
            label = f"rule {rule}" if place == 0 else None
            style: dict[str, Any] = {"fmt": marker, "mfc": None, "label": label}
            bars(axes, [place + 0.2 * (i - 0.5)], [found], 1 - i, lying=True, **style)
            axes.annotate(
                f"{row['worst_bits']} bit",
                (share, place + 0.2 * (i - 0.5)),
                textcoords="offset points",
                xytext=(8 if share < 0.5 else -8, 4),
                ha="left" if share < 0.5 else "right",
                fontsize=6.5,
            )
    axes.set_yticks(range(len(controls)), controls)
    axes.invert_yaxis()
    axes.set_xlim(-0.05, 1.05)
    axes.set_xlabel(
        "share of blocks that Eve breaks; beside it, the most bits that Eve holds, or made differ"
    )
    axes.legend(loc="center", fontsize=7)
    blocks, last = rows[0]["blocks"], rows[0]["last_seed"]
    return f"{blocks} blocks each, one in each of {blocks} runs, seeds 0 to {last}; 95 % intervals"
