"""The panel of the agreement test: a bar a candidate, the verdict in words, the plane, a legend.

A bar's first half runs from the prediction to the edge of D_c (gauge 0 to 1), its second half on to
the edge of D_e (1 to alpha), so that the half that matters is as wide as the one that does not.
"""

import itertools
from collections.abc import Sequence
from typing import Final

from rich.text import Text

from protocol.agreement import INSIDE
from protocol.messages import PlantModel, PlantStatus
from wyner.dashboard import plane
from wyner.dashboard.parts import line, rule
from wyner.dashboard.text import BEYOND, DOT, EDGE, FAINT, LINE, STYLES, longest, number

PLANE_ROWS: Final = 3
"""Rows below which the plane is left to the bars."""

BARS_AT_MOST: Final = 16

NARROWEST: Final = 8
"""Cells below which half a bar is not drawn."""

BESIDE: Final = 22
"""Cells of a line beside its bar: the candidate's number, the gauge and what it means."""


def verdict(status: PlantStatus) -> str:
    """What the agreement test said of the pictured step, in words (equation 20)."""
    symbol = status.pictured_symbol
    if symbol >= 0:
        return f"KEY {symbol}: only input {symbol} explains it"
    inside = status.pictured_inside
    if inside == 0:
        return "no key: no input explains it"
    if inside > 1:
        return f"no key: {inside} inputs explain it"
    return "no key: outside a D_e, so Eve knows"


def agreement(
    model: PlantModel | None, status: PlantStatus | None, width: int, rows: int
) -> list[Text]:
    """The last pictured step, for a place of ``rows`` lines of ``width`` cells.

    Bars come first, then the verdict; the plane takes what is left, from `PLANE_ROWS` on.
    """
    if status is None:
        return [rule("Key test", width), line(" no step pictured yet")]
    title = f"Key test at step {status.pictured_k}"
    if model is None or not plane.fits(model, status):
        return [rule(title, width), line(" the plant's model was not received yet")]
    axes = plane.axes_of(model)
    gauges = status.pictured_gauges
    room = rows - 3  # rule, scale, verdict
    with_plane = room - min(len(gauges), 2) >= PLANE_ROWS + 1
    most = max(1, min(room - (PLANE_ROWS + 1 if with_plane else 0), BARS_AT_MOST, len(gauges)))
    style = STYLES["good"] if status.pictured_symbol >= 0 else ""
    body = [*_bars(model, gauges, width, most), line(f" {verdict(status)}", style)]
    if with_plane:
        body += [*_plane(model, status, width, room - most - 1), _legend(width)]
    return [rule(title, width, axes.words, axes.short), *body]


def _plane(model: PlantModel, status: PlantStatus, width: int, rows: int) -> list[Text]:
    lines = []
    for cells in plane.draw(model, status, width - 2, rows):
        drawn = line(" ")
        for style, run in itertools.groupby(cells, key=lambda cell: cell.style):
            drawn.append("".join(cell.character for cell in run), style=STYLES[style])
        lines.append(drawn)
    return lines


def _legend(width: int) -> Text:
    text = longest(
        width - 1,
        f"{DOT} next state   0 1 where each input leads, in its D_c   arrows: D_e goes on",
        f"{DOT} next state  0 1 where inputs lead",
    )
    return line(f" {text}", STYLES["label"])


def _bars(model: PlantModel, gauges: Sequence[float], width: int, most: int) -> list[Text]:
    """A line for each of the nearest candidates, and a line that names the marks."""
    half = max(NARROWEST, (width - BESIDE) // 2)
    alpha = plane.spread(model)
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
