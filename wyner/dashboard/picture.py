"""The panel of the agreement test: a bar a candidate, the verdict in words, the plane, a legend."""

import itertools
from typing import Final

from rich.text import Text

from protocol.messages import PlantModel, PlantStatus
from wyner.dashboard import plane
from wyner.dashboard.gauges import bars
from wyner.dashboard.text import STYLES, Glyphs, fit, longest, rule

PLANE_ROWS: Final = 3
"""Rows below which the plane is left to the bars."""

BARS_AT_MOST: Final = 16


def agreement(
    model: PlantModel | None,
    status: PlantStatus | None,
    width: int,
    rows: int,
    glyphs: Glyphs,
    *,
    unicode: bool,
) -> list[Text]:
    """The last pictured step, in exactly ``rows`` lines of ``width`` cells.

    Bars come first, then the verdict; the plane takes what is left, from `PLANE_ROWS` on.
    """
    if status is None:
        lines = [rule(glyphs, "Agreement", width), Text(" no step pictured yet")]
    elif model is None or not plane.fits(model, status):
        title = f"Agreement at step {status.pictured_k}"
        lines = [rule(glyphs, title, width), Text(" the plant's model was not heard yet")]
    else:
        axes = plane.axes_of(model.B, model.defender_H, model.defender_h)
        title = f"Agreement at step {status.pictured_k}"
        lines = [rule(glyphs, title, width, axes.words, axes.short)]
        gauges = status.pictured_gauges
        room = rows - 3  # rule, scale, verdict
        with_plane = room - min(len(gauges), 2) >= PLANE_ROWS + 1
        most = room - (PLANE_ROWS + 1 if with_plane else 0)
        lines += bars(
            gauges,
            plane.spread(model),
            width,
            max(1, min(most, BARS_AT_MOST)),
            glyphs,
            own_shape=bool(model.eavesdropper_H),
        )
        agreed = status.pictured_symbol >= 0
        lines.append(Text(f" {plane.verdict(status)}", style=STYLES["good"] if agreed else ""))
        if with_plane:
            lines += _plane(model, status, width, rows - len(lines) - 1, unicode=unicode)
            lines.append(_legend(glyphs, width))
    lines += [Text()] * (rows - len(lines))
    return [fit(line, width) for line in lines[:rows]]


def _plane(
    model: PlantModel, status: PlantStatus, width: int, rows: int, *, unicode: bool
) -> list[Text]:
    lines = []
    for cells in plane.draw(model, status, width - 2, rows, unicode=unicode):
        line = Text(" ")
        for kind, run in itertools.groupby(cells, key=lambda cell: cell.kind):
            line.append("".join(cell.character for cell in run), style=STYLES[kind])
        lines.append(line)
    return lines


def _legend(glyphs: Glyphs, width: int) -> Text:
    dot = glyphs.dot
    return Text(
        " "
        + longest(
            width - 1,
            f"{dot} next state   0 1 predictions, each in its D_c   arrows: D_e goes on",
            f"{dot} next state  0 1 predictions in D_c",
            f"{dot} next state  0 1 predictions",
        ),
        style=STYLES["label"],
    )
