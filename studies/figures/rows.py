"""The registry of figures, and the rows of their data files."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from protocol.statistics import Interval
from wyner.drawing.style import COLOURS, MARKERS
from wyner.sweeps.grid import Row
from wyner.sweeps.results import read_table

Rows = list[Row]


Draw = Callable[[Figure, Path], str]


class RegisteredFigure(NamedTuple):
    """One figure: how it is drawn, from which data files, and its size in inches."""

    draw: Draw
    data: tuple[str, ...]
    size: tuple[float, float]


FIGURES: Final[dict[str, RegisteredFigure]] = {}
"""The figures."""


def rate_in(unit: str, kind: str = "") -> str:
    """What an axis says of a rate. It is no secrecy: `nearest-centre` names all of these keys."""
    return f"{kind}rate by the paper's rule ({unit});\nnone of it is secret"


def figure(name: str, *data: str, size: tuple[float, float]) -> Callable[[Draw], Draw]:
    """Register a function that draws from the folder of the data, and returns the note."""

    def register(draw: Draw) -> Draw:
        FIGURES[name] = RegisteredFigure(draw, data, size)
        return draw

    return register


def plain_rows(path: Path) -> Rows:
    """The rows of a data file that is no sweep's, with numbers as numbers."""
    return [{k: _number(v) for k, v in row.items()} for row in read_table(path)]


def _number(text: str) -> Any:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def intervals(rows: Rows, name: str) -> list[Interval]:
    """A column of rows with its limits, ``name_low`` and ``name_high``."""
    return [Interval(row[name], row[f"{name}_low"], row[f"{name}_high"]) for row in rows]


def bars(
    axes: Axes,
    at: Sequence[float],
    values: Sequence[Interval],
    place: int,
    *,
    lying: bool = False,
    **style: Any,
) -> None:
    """Points with intervals: the marker and colour of a place among the series."""
    middle = [v.value for v in values]
    reach = [
        [max(v.value - v.low, 0.0) for v in values],
        [max(v.high - v.value, 0.0) for v in values],
    ]
    x, y = (middle, at) if lying else (at, middle)
    style = {"fmt": MARKERS[place], "color": COLOURS[place], "mfc": "none", "capsize": 2} | style
    axes.errorbar(x, y, xerr=reach if lying else None, yerr=None if lying else reach, **style)
