"""What the panels are put together from: every panel is a list of lines of rich's Text."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

from rich.cells import cell_len
from rich.text import Text

from wyner.dashboard.text import STYLES, drawn, longest

LABEL: Final = 14
"""Cells of the labels at the left."""

VALUE_AT: Final = LABEL + 2
"""The cell at which a labelled value begins."""

Of = TypeVar("Of")


def line(text: str = "", style: str = "") -> Text:
    """One line that is never wrapped, but cut where there is no room."""
    return Text(text, style=style, no_wrap=True, overflow="ellipsis")


def rule(title: str, width: int, *notes: str, style: str = "") -> Text:
    """A titled rule, with the longest of the notes that there is room for."""
    note = longest(width - cell_len(title) - 4, *notes)
    text = line(title, STYLES["title"]).append(f"  {note}" if note else "", style or "default")
    return text.append(" " + "─" * max(0, width - text.cell_len - 1), "cyan")


def labelled(label: str, value: Text) -> Text:
    """A label in its column, and its value."""
    name = line(drawn(label), STYLES["label"])
    name.truncate(LABEL, overflow="ellipsis", pad=True)
    return line(" ").append(name).append(" ").append(value)


def beside(left: Sequence[Text], right: Sequence[Text], width: int) -> list[Text]:
    """Two panels side by side, the left one ``width`` cells wide."""
    lines = []
    for i in range(max(len(left), len(right))):
        whole = left[i].copy() if i < len(left) else line()
        whole.truncate(width, overflow="ellipsis", pad=True)
        lines.append(whole.append(" ").append(right[i] if i < len(right) else ""))
    return lines


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


def table(first: str, columns: Sequence[Column[Of]], rows: Iterable[tuple[str, Of]]) -> list[Text]:
    """A heading, and a line a row: its name below ``first``, then the columns."""
    head = "".join(f" {column.title:>{column.width}}" for column in columns)
    lines = [line(f" {first:<{LABEL}}{head}", STYLES["label"])]
    for name, of in rows:
        label = line(drawn(name))
        label.truncate(LABEL, overflow="ellipsis", pad=True)
        values = "".join(f" {column.value(of):>{column.width}}" for column in columns)
        lines.append(line(" ").append(label).append(values))
    return lines
