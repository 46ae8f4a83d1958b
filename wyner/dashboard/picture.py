"""The panel of the key test: a bar for each candidate, and the verdict in words.

A bar's first half runs from the prediction to the edge of D_c (gauge 0 to 1), its second half on to
the edge of D_e (1 to alpha), so that the half that matters is as wide as the one that does not.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from rich.text import Text

from protocol.agreement import INSIDE
from protocol.convex import corners
from protocol.messages import PlantModel
from protocol.messages.management import PicturedStep
from wyner.dashboard.text import BEYOND, DOT, EDGE, FAINT, LINE, STYLES, line, longest, number, rule

BARS_AT_MOST: Final = 16

BESIDE: Final = 22
"""Cells of a line beside its bar: the candidate's number, the gauge and what it means."""


def verdict(step: PicturedStep) -> str:
    """What the agreement test said of the pictured step, in words (equation 20)."""
    if step.symbol >= 0:
        return f"KEY {step.symbol}: only input {step.symbol} explains it"
    if step.inside == 0:
        return "no key: no input explains it"
    if step.inside > 1:
        return f"no key: {step.inside} inputs explain it"
    return "no key: outside a D_e, so Eve knows"


def spread(model: PlantModel) -> float:
    """How many times D_c must be scaled to hold D_e: alpha, where it has no shape of its own."""
    if not model.eavesdropper_H or len(model.A) > 4:
        return model.alpha
    ends = corners(model.eavesdropper_H, model.eavesdropper_h)
    gauges = ends @ np.array(model.defender_H).T / np.array(model.defender_h)
    return float(gauges.max())


def agreement(
    model: PlantModel | None, step: PicturedStep | None, width: int, rows: int
) -> list[Text]:
    """The last pictured step in at most ``rows`` lines of ``width`` cells."""
    if step is None:
        return [rule("Key test", width), line(" no step pictured yet")]
    title = rule(f"Key test at step {step.k}", width)
    if model is None:
        return [title, line(" the plant's model was not received yet")]
    most = max(1, min(rows - 3, BARS_AT_MOST, len(step.gauges)))  # title, scale and verdict
    style = STYLES["good"] if step.symbol >= 0 else ""
    return [title, *_bars(model, step.gauges, width, most), line(f" {verdict(step)}", style)]


def _bars(model: PlantModel, gauges: Sequence[float], width: int, most: int) -> list[Text]:
    """A line for each of the nearest candidates, and a line that names the marks."""
    half = (width - BESIDE) // 2
    alpha = spread(model)
    nearest = sorted(range(len(gauges)), key=lambda i: (gauges[i], i))[:most]
    lines = []
    for i in sorted(nearest):
        lines.append(line(f" {i:<3}").append(_bar(gauges[i], alpha, half)))
    scale = line("    ").append("0".ljust(half) + "D_c".ljust(half + 1), style=STYLES["label"])
    more = f"   and {len(gauges) - most} more" if len(gauges) > most else ""
    relation = "within" if model.eavesdropper_H else "="
    whole = f"D_e {relation} {number(alpha)} D_c{more}"
    return [*lines, scale.append(longest(width - scale.cell_len, whole, f"D_e{more}"))]


def _bar(gauge: float, alpha: float, half: int) -> Text:
    inside = gauge <= INSIDE
    beyond = gauge > alpha
    if inside:
        at = round(gauge * (half - 1))
    elif beyond or alpha <= 1.0:
        at = 2 * half + 1
    else:
        at = half + 1 + round((gauge - 1) / (alpha - 1) * (half - 1))
    bar = line()
    for j, cell in enumerate([LINE] * half + [EDGE] + [FAINT] * half + [EDGE]):
        if j == at:
            bar.append(BEYOND if beyond else DOT, style=STYLES["next"])
        else:
            bar.append(cell, style=STYLES["defender" if j <= half else "eavesdropper"])
    word = "in D_c" if inside else "beyond" if beyond else "outside"
    bar.append(f" {longest(5, f'{gauge:.2f}', number(gauge)):>5} ")
    return bar.append(word, style=STYLES["good" if inside else ""])
