"""The registry of figures, and the rows of their data files."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

from matplotlib.figure import Figure

from wyner.sweeps.grid import Row, SweepError
from wyner.sweeps.results import read_table

Rows = list[Row]


Draw = Callable[[Figure, Path], str]


class Kind(NamedTuple):
    """One figure: how it is drawn, from which data files, and its size in inches."""

    draw: Draw
    data: tuple[str, ...]
    size: tuple[float, float]


FIGURES: Final[dict[str, Kind]] = {}
"""The figures."""


def figure(name: str, *data: str, size: tuple[float, float]) -> Callable[[Draw], Draw]:
    """Register a function that draws from the folder of the data, and returns the note."""

    def register(draw: Draw) -> Draw:
        FIGURES[name] = Kind(draw, data, size)
        return draw

    return register


class FigureError(Exception):
    """A figure that cannot be drawn; the text names the data file."""


def plain_rows(path: Path) -> Rows:
    """The rows of a data file that is no sweep's, with numbers as numbers."""
    try:
        return [{k: _number(v) for k, v in row.items()} for row in read_table(path)]
    except SweepError as error:
        raise FigureError(str(error)) from None


def _number(text: str) -> Any:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
