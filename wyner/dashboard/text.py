"""Words, figures and lines: short numbers, sparklines, nothing that could move a cursor.

Every panel is a list of lines of rich's Text.
"""

import math
import unicodedata
from collections.abc import Sequence
from functools import lru_cache
from itertools import zip_longest
from typing import Final

from rich.cells import cell_len
from rich.text import Text

SYMBOLS: Final = "0123456789abcdefghijklmnopqrstuvwxyz"
"""A character for each symbol of an alphabet that has no more."""

FIGURE: Final = 8
"""Cells of a component of the state, its sign included."""

STYLES: Final[dict[str, str]] = {
    "title": "bold cyan",
    "label": "dim",
    "good": "green",
    "bad": "bold red",
    "wrong": "underline red",
    "eavesdropper": "yellow",
    "defender": "green",
    "next": "bold magenta",
    "claimed": "yellow",
    "true": "green",
    "": "",
}


LINE: Final = "─"
LEVELS: Final = "▁▂▃▄▅▆▇█"
EDGE: Final = "┤"
FAINT: Final = "·"
DOT: Final = "●"
BEYOND: Final = "▶"
"""Characters of sparklines and of the bars of the agreement test."""


def in_words(service: str, phase: str) -> str:
    """A service's phase for people."""
    if phase == "greeting":
        return f"{service} looks for a {'controller' if service == 'plant' else 'plant'}"
    return f"{service} {phase}"


def longest(room: int, *texts: str) -> str:
    """The first of ``texts``, longest first, that fits into ``room`` cells; else nothing."""
    return next((text for text in texts if cell_len(text) <= room), "")


def drawn(text: str) -> str:
    """Text from elsewhere, for the screen: a cell a character, ``·`` for those of another width."""
    return "".join(c if c.isprintable() and cell_len(c) == 1 else "·" for c in letters(text))


@lru_cache(maxsize=128)
def letters(text: str) -> str:
    """The text with accents joined to their characters, as a reader counts them."""
    return unicodedata.normalize("NFC", text)


def sparkline(values: Sequence[float], levels: str) -> str:
    """Values as bars between the smallest and the largest of them."""
    if not values:
        return ""
    low, high = min(values), max(values)
    if high == low:
        return levels[len(levels) // 2] * len(values)
    top = len(levels) - 1
    scale = 0.5 if math.isinf(high - low) else 1.0
    span = high * scale - low * scale
    return "".join(levels[round((v * scale - low * scale) / span * top)] for v in values)


def number(value: float) -> str:
    """A figure in at most six characters, its sign aside."""
    if value == 0:
        return "0"
    if 0.01 <= abs(value) < 1000:
        return f"{value:.3g}"
    return _scientific(f"{value:.0e}")


def component(value: float, sign: str = "-") -> str:
    """A component of the state in at most `FIGURE` characters; ``sign`` is that of a format."""
    short = _scientific(f"{value:{sign}.1e}")
    return longest(FIGURE, f"{value:{sign}.3f}", f"{value:{sign}.1f}", short)


def _scientific(text: str) -> str:
    return text.replace("e-0", "e-").replace("e+0", "e").replace("e+", "e")


def symbol_of(symbol: int, size: int) -> str:
    """A symbol of an alphabet of ``size``: 0 to 9 and a to z; beyond 36 symbols two hex digits."""
    return f"{symbol:02x}" if size > len(SYMBOLS) else SYMBOLS[symbol]


def count(value: int) -> str:
    """A count in at most six characters."""
    if value < 100_000:
        return str(value)
    if value < 10_000_000:
        return f"{value // 1000}k"
    return f"2^{value.bit_length() - 1}"


def percent(right: int, scored: int) -> str:
    """A share in whole per cent, never rounded up to a hundred."""
    return f"{100 * right // scored} %" if scored else "-"


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
    for one, other in zip_longest(left, right, fillvalue=line()):
        whole = one.copy()
        whole.truncate(width, overflow="ellipsis", pad=True)
        lines.append(whole.append(" ").append(other))
    return lines
