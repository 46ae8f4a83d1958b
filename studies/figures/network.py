"""The figure of what a network costs: control cost and message rate, by fallback."""

from pathlib import Path

from matplotlib.figure import Figure

from studies.figures.rows import bars, figure, intervals, plain_rows, rate_in
from wyner.drawing.style import MARKERS

SHOWN = (
    ("loss", "loss of a message, each way"),
    ("delay", "mean round trip in periods"),
)


@figure("network", "network", size=(7.4, 5.0))
def draw_network(figure: Figure, data: Path) -> str:
    """Cost above, rate below; losses on the left, delays on the right."""
    rows = plain_rows(data / "network.csv")
    axes = figure.subplots(2, 2, sharex="col", sharey="row")
    for column, (part, label) in enumerate(SHOWN):
        for row, (name, unit) in enumerate(
            (("cost", "control cost a step"), ("bits_per_second", rate_in("bit/s")))
        ):
            plot = axes[row][column]
            for place, fallback in enumerate(dict.fromkeys(r["fallback"] for r in rows)):
                own = [r for r in rows if r["part"] == part and r["fallback"] == fallback]
                bars(
                    plot,
                    [r["value"] for r in own],
                    intervals(own, name),
                    place,
                    fmt=f"{MARKERS[place]}-",
                    lw=1,
                    label=fallback,
                )
            if column == 0:
                plot.set_ylabel(unit)
        axes[0][column].set_yscale("log")
        axes[1][column].set_ylim(bottom=0)
        axes[1][column].set_xlabel(label)
    axes[0][0].legend(title="fallback", fontsize=7)
    figure.suptitle("What a network costs the loop `sustained`")
    first, seeds = rows[0], [int(r["seed"]) for r in rows]
    return (
        f"{first['runs']} runs of {first['steps']} steps a point, seeds {min(seeds)} to "
        f"{max(seeds)}, one a value; bars: 95 % Student intervals over runs"
    )
