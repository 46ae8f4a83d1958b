"""The picture of a secrecy report."""

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wyner.drawing.style import COLOURS
from wyner.runs.score.report import Report


def draw_report(axes: Axes, report: Report) -> None:
    """What counts as secret by the paper's rule, and what each one leaves of it at most."""
    names = ["by the paper's rule", *(t.name for t in report.taps)]
    left = [t.left_bits.high if t.left_bits is not None else math.nan for t in report.taps]
    values = [report.claimed_bits, *left]
    bars = axes.barh(
        names, np.nan_to_num(values), color=["0.5", *(COLOURS[1] for _ in report.taps)]
    )
    bars[0].set_hatch("//")
    for place, value in enumerate(values):
        told = "not scored" if math.isnan(value) else f"{value:.1f}"
        axes.text(0.0 if math.isnan(value) else value, place, f" {told}", va="center")
    axes.invert_yaxis()
    axes.grid(visible=False)
    axes.set_xlabel("bits counted as secret, and bits left at most")
    axes.set_xlim(0, 1.15 * max(1.0, *(value for value in values if not math.isnan(value))))


def draw_scored(figure: Figure, report: Report) -> str:
    """The same as a figure of its own, under the verdict; returns the note."""
    axes = figure.subplots()
    draw_report(axes, report)
    axes.set_title(report.verdict(), fontsize=9, loc="left")
    return ""
