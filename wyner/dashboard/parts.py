"""What the panels are put together from, all of it rich's: titled rules, labelled rows, tables."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

from rich.cells import cell_len
from rich.console import Group, RenderableType
from rich.padding import Padding
from rich.rule import Rule
from rich.table import Table
from rich.text import Text

from wyner.dashboard.text import STYLES, drawn, longest

LABEL: Final = 14
"""Cells of the labels at the left."""

WIDE: Final = 40
"""Cells from which on a column is a sentence: it begins at its left, and is as long as it is."""

Of = TypeVar("Of")

VALUE_AT: Final = LABEL + 2
"""The cell at which what a label is of begins."""

Row = tuple[str, RenderableType]
"""A label, and what it is of."""


def line(text: str = "", style: str = "") -> Text:
    """One line that is never wrapped, but cut where there is no room."""
    return Text(text, style=style, no_wrap=True, overflow="ellipsis")


def rule(title: str, width: int, *notes: str, style: str = "") -> Rule:
    """A titled rule, with the longest of the notes that there is room for."""
    note = longest(width - cell_len(title) - 4, *notes)
    text = Text.assemble(
        (title, STYLES["title"]), ("  " + note if note else "", style or "default")
    )
    return Rule(text, align="left", style="cyan")


def labelled(rows: Iterable[Row]) -> Padding:
    """Rows of a label and what it is of."""
    grid = Table.grid(padding=(0, 1, 0, 0), expand=True)
    grid.add_column(width=LABEL, no_wrap=True, overflow="ellipsis", style=STYLES["label"])
    grid.add_column(ratio=1, no_wrap=True, overflow="ellipsis")
    for label, value in rows:
        grid.add_row(line(drawn(label)), value)
    return Padding(grid, (0, 0, 0, 1))


def titled(title: Rule, *body: RenderableType) -> Group:
    """A panel: its rule, and below it what it shows."""
    return Group(title, *body)


@dataclass(frozen=True, slots=True)
class Column(Generic[Of]):
    """A column of a table; a narrow screen does without those of the last ranks."""

    title: str
    width: int
    rank: int
    value: Callable[[Of], str]


def fitting(columns: Sequence[Column[Of]], room: int) -> list[Column[Of]]:
    """The columns that ``room`` cells hold, those of the first ranks, in their own order."""
    kept = []
    for column in sorted(columns, key=lambda column: column.rank):
        room -= column.width + 1
        if room < 0:
            break
        kept.append(column)
    return sorted(kept, key=columns.index)


def table(
    first: str, width: int, columns: Sequence[Column[Of]], rows: Iterable[tuple[str, Of]]
) -> Table:
    """A table: names of ``width`` cells below ``first``, then the columns."""
    drawn_table = Table(box=None, padding=(0, 1, 0, 0), pad_edge=False, header_style="dim")
    drawn_table.add_column(first, width=width, no_wrap=True, overflow="ellipsis")
    for column in columns:
        where = {"justify": "right", "width": column.width} if column.width < WIDE else {}
        drawn_table.add_column(column.title, no_wrap=True, **where)  # type: ignore[arg-type]
    for name, of in rows:
        drawn_table.add_row(line(drawn(name)), *(line(column.value(of)) for column in columns))
    return drawn_table
