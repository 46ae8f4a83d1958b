"""The figure of `wyner design --noise`."""

from typing import Any

from matplotlib.figure import Figure

from wyner.drawing.style import COLOURS, MARKERS


def draw_table(figure: Figure, table: dict[str, Any]) -> None:
    """What `wyner design --noise` prints: the proof below, a measured tap above, the claim flat."""
    axes = figure.subplots()
    rows = table["rows"]
    ratios = [row["ratio"] for row in rows]
    axes.axhline(table["claimed_bits"], color="0.4", ls="--", lw=1, label="claimed by the rule")
    taps = [row for row in rows if row["measured"]]
    if taps:
        bits = [row["measured"]["bits_per_coin"] for row in taps]
        ends = [row["measured"]["interval_95"] for row in taps]
        axes.errorbar(
            [row["ratio"] for row in taps],
            bits,
            yerr=[
                [b - low for b, (low, _) in zip(bits, ends, strict=True)],
                [high - b for b, (_, high) in zip(bits, ends, strict=True)],
            ],
            fmt=MARKERS[1],
            color=COLOURS[1],
            capsize=2,
            label="a tap who weighs every sequence, measured",
        )
    axes.plot(
        ratios, [row["bits_per_coin"] for row in rows], color=COLOURS[0], label="any tap, proved"
    )
    axes.set_xlabel("her noise over the half-width of $\\mathcal{D}_c$")
    axes.set_ylabel("bits left of a coin")
    axes.set_title(f"{table['scenario']}: what any tap leaves; offers: {table['offers']}")
    axes.set_ylim(bottom=0)
    axes.legend(fontsize=7, loc="lower right")
