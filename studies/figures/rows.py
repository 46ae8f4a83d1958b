"""The rows of a figure's data file."""

from pathlib import Path
from typing import Any

from wyner.sweeps.grid import Row, SweepError
from wyner.sweeps.results import read_table

Rows = list[Row]


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
