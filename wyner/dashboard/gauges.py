"""How far the next state lies from each prediction, as bars: inside D_c, outside it, outside D_e.

A bar's first half runs from the prediction to the edge of D_c (gauge 0 to 1), its second half on to
the edge of D_e (1 to alpha), so that the half that matters is as wide as the one that does not.
"""

from collections.abc import Sequence
from typing import Final

from rich.table import Table
from rich.text import Text

from protocol.agreement import INSIDE
from wyner.dashboard.parts import line
from wyner.dashboard.text import BEYOND, DOT, EDGE, FAINT, LINE, STYLES, longest, number

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
    *,
    own_shape: bool = False,
) -> Table:
    """One row a candidate, and a row that names the marks.

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
    own_shape : bool
        Whether alpha D_c only holds D_e, which has a shape of its own.
    """
    half = max(NARROWEST, (width - INDEX - WORDS - 4) // 2)
    grid = Table.grid()
    grid.add_column(width=INDEX, no_wrap=True)
    grid.add_column(no_wrap=True, overflow="crop")
    shown = shown_first(gauges, most)
    for i in shown:
        grid.add_row(line(f" {i}"), _bar(gauges[i], alpha, half))
    scale = line().append("0".ljust(half) + "D_c".ljust(half + 1), style=STYLES["label"])
    hidden = len(gauges) - len(shown)
    more = f"   and {hidden} more" if hidden else ""
    relation = "within" if own_shape else "="
    room = width - INDEX - scale.cell_len
    scale.append(longest(room, f"D_e {relation} {number(alpha)} D_c{more}", f"D_e{more}"))
    grid.add_row(line(), scale)
    return grid


def _bar(gauge: float, alpha: float, half: int) -> Text:
    inside = gauge <= INSIDE
    beyond = gauge > alpha
    if inside:
        at = round(gauge * (half - 1))
    elif beyond or alpha <= 1.0:
        at = 2 * half + 1
    else:
        at = half + 1 + round((gauge - 1) / (alpha - 1) * (half - 1))
    cells = [LINE] * half + [EDGE] + [FAINT] * half + [EDGE]
    bar = line()
    for j, cell in enumerate(cells):
        if j == at:
            bar.append(BEYOND if beyond else DOT, style=STYLES["next"])
        else:
            bar.append(cell, style=STYLES["defender" if j <= half else "eavesdropper"])
    word = "in D_c" if inside else "beyond" if beyond else "outside"
    value = longest(5, f"{gauge:.2f}", number(gauge))
    bar.append(f" {value:>5} ")
    bar.append(word, style=STYLES["good" if inside else ""])
    return bar
