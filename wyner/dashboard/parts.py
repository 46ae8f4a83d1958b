"""What the panels are put together from: every panel is a list of lines of rich's Text."""

from collections.abc import Sequence
from typing import Final

from rich.cells import cell_len
from rich.text import Text

from wyner.dashboard.text import STYLES, drawn, longest

LABEL: Final = 14
"""Cells of the labels at the left."""

VALUE_AT: Final = LABEL + 2
"""The cell at which a labelled value begins."""


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
