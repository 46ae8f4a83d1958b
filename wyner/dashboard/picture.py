"""The panel of the agreement test: a bar a candidate, the verdict in words, the plane, a legend."""

import itertools
from typing import Final

from rich.console import Group, RenderableType
from rich.text import Text

from protocol.messages import PlantModel, PlantStatus
from wyner.dashboard import plane
from wyner.dashboard.gauges import bars
from wyner.dashboard.parts import line, rule, titled
from wyner.dashboard.text import DOT, STYLES, longest

PLANE_ROWS: Final = 3
"""Rows below which the plane is left to the bars."""

BARS_AT_MOST: Final = 16


def agreement(
    model: PlantModel | None,
    status: PlantStatus | None,
    width: int,
    rows: int,
) -> RenderableType:
    """The last pictured step, for a place of ``rows`` lines of ``width`` cells.

    Bars come first, then the verdict; the plane takes what is left, from `PLANE_ROWS` on.
    """
    if status is None:
        return titled(rule("Key test", width), line(" no step pictured yet"))
    title = f"Key test at step {status.pictured_k}"
    if model is None or not plane.fits(model, status):
        return titled(rule(title, width), line(" the plant's model was not heard yet"))
    axes = plane.axes_of(model.B, model.defender_H, model.defender_h)
    gauges = status.pictured_gauges
    room = rows - 3  # rule, scale, verdict
    with_plane = room - min(len(gauges), 2) >= PLANE_ROWS + 1
    most = max(1, min(room - (PLANE_ROWS + 1 if with_plane else 0), BARS_AT_MOST, len(gauges)))
    own_shape = bool(model.eavesdropper_H)
    agreed = status.pictured_symbol >= 0
    body: list[RenderableType] = [
        bars(gauges, plane.spread(model), width, most, own_shape=own_shape),
        line(f" {plane.verdict(status)}", STYLES["good"] if agreed else ""),
    ]
    if with_plane:
        body.append(_plane(model, status, width, room - most - 1))
        body.append(_legend(width))
    return titled(rule(title, width, axes.words, axes.short), *body)


def _plane(model: PlantModel, status: PlantStatus, width: int, rows: int) -> Group:
    lines = []
    for cells in plane.draw(model, status, width - 2, rows):
        drawn = line(" ")
        for kind, run in itertools.groupby(cells, key=lambda cell: cell.kind):
            drawn.append("".join(cell.character for cell in run), style=STYLES[kind])
        lines.append(drawn)
    return Group(*lines)


def _legend(width: int) -> Text:
    dot = DOT
    return line(
        " "
        + longest(
            width - 1,
            f"{dot} next state   0 1 where each input leads, in its D_c   arrows: D_e goes on",
            f"{dot} next state  0 1 where inputs lead",
            f"{dot} next state  0 1 predictions",
        ),
        STYLES["label"],
    )
