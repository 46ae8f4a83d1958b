"""How far the next state lies from each prediction, as bars: inside D_c, outside it, outside D_e.

A bar's first half runs from the prediction to the edge of D_c (gauge 0 to 1), its second half on to
the edge of D_e (1 to alpha), so that the half that matters is as wide as the one that does not.
"""

from collections.abc import Sequence
from typing import Final

from rich.text import Text

from protocol.agreement import INSIDE
from wyner.dashboard.text import STYLES, Glyphs, longest, number

INDEX: Final = 4
"""Cells of a candidate's number, at the left of its bar."""

WORDS: Final = 14
"""Cells kept at the right for the gauge and what it means."""

NARROWEST: Final = 8
"""Cells below which half a bar is not drawn."""


def shown_first(gauges: Sequence[float], most: int) -> list[int]:
    """The candidates to draw where there is room for ``most``: the nearest, in their own order."""
    nearest = sorted(range(len(gauges)), key=lambda i: (gauges[i], i))[:most]
    return sorted(nearest)


def bars(
    gauges: Sequence[float],
    alpha: float,
    width: int,
    most: int,
    glyphs: Glyphs,
    *,
    own_shape: bool = False,
) -> list[Text]:
    """One line a candidate, and a line that names the marks.

    Parameters
    ----------
    gauges : sequence of float
        Of x(k+1) from each prediction: 1 is the edge of D_c.
    alpha : float
        D_e = alpha D_c.
    width : int
        Cells of a line.
    most : int
        Candidates for which there is room.
    glyphs : Glyphs
        Characters that the terminal can show.
    own_shape : bool
        Whether alpha D_c only holds D_e, which has a shape of its own.
    """
    half = max(NARROWEST, (width - INDEX - WORDS - 4) // 2)
    rows = [_bar(i, gauges[i], alpha, half, glyphs) for i in shown_first(gauges, most)]
    scale = Text(" " * INDEX + "0".ljust(half), style=STYLES["label"])
    hidden = len(gauges) - len(rows)
    more = f"   and {hidden} more" if hidden else ""
    scale.append("D_c".ljust(half + 1))
    relation = "within" if own_shape else "="
    scale.append(
        longest(width - scale.cell_len, f"D_e {relation} {number(alpha)} D_c{more}", "D_e")
    )
    return [*rows, scale]


def _bar(i: int, gauge: float, alpha: float, half: int, glyphs: Glyphs) -> Text:
    inside = gauge <= INSIDE
    beyond = gauge > alpha
    if inside:
        at = round(gauge * (half - 1))
    elif beyond or alpha <= 1.0:
        at = 2 * half + 1
    else:
        at = half + 1 + round((gauge - 1) / (alpha - 1) * (half - 1))
    cells = [glyphs.rule] * half + [glyphs.edge] + [glyphs.faint] * half + [glyphs.edge]
    line = Text(f" {i:<{INDEX - 1}}")
    for j, cell in enumerate(cells):
        if j == at:
            line.append(glyphs.beyond if beyond else glyphs.dot, style=STYLES["next"])
        else:
            line.append(cell, style=STYLES["defender" if j <= half else "eavesdropper"])
    word = "in D_c" if inside else "beyond" if beyond else "outside"
    value = longest(5, f"{gauge:.2f}", number(gauge))
    line.append(f" {value:>5} ")
    line.append(word, style=STYLES["good" if inside else ""])
    return line
