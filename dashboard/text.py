"""Lines and figures as text: exact widths, short numbers, nothing that could move a cursor."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from rich.cells import cell_len
from rich.text import Text

LABEL: Final = 14
"""Columns of the labels at the left."""

STYLES: Final[dict[str, str]] = {
    "rule": "cyan",
    "title": "bold cyan",
    "label": "dim",
    "good": "green",
    "bad": "bold red",
    "wrong": "underline red",
    "eavesdropper": "yellow",
    "defender": "green",
    "centre": "bold",
    "next": "bold magenta",
    "": "",
}


@dataclass(frozen=True, slots=True)
class Glyphs:
    """Characters of rules and sparklines."""

    rule: str
    levels: str


UNICODE: Final = Glyphs("─", "▁▂▃▄▅▆▇█")
"""For terminals whose encoding is Unicode."""
ASCII: Final = Glyphs("-", "_.:-=+*#")
"""For all others."""


def fit(line: Text, width: int, style: str = "") -> Text:
    """A line cut with an ellipsis, or padded, to a width in cells."""
    line = line.copy()
    line.truncate(width, overflow="ellipsis", pad=True)
    if style:
        line.stylize(style)
    return line


def in_ascii(line: Text) -> Text:
    """The same line in ASCII, character for character."""
    known = {"…": "~", "·": "."}
    text = "".join(c if c.isascii() else known.get(c, "?") for c in line.plain)
    return Text(text, style=line.style, spans=line.spans)


def longest(room: int, *texts: str) -> str:
    """The first of ``texts``, longest first, that fits into ``room`` cells; else nothing."""
    return next((text for text in texts if cell_len(text) <= room), "")


def printable(text: str) -> str:
    """Text from elsewhere with everything that could move a cursor shown as ``·``."""
    return "".join(c if c.isprintable() and cell_len(c) == 1 else "·" for c in text)


def sparkline(values: Sequence[float], levels: str) -> str:
    """Values as bars between their smallest and their largest."""
    if not values:
        return ""
    low, high = min(values), max(values)
    if high == low:
        return levels[len(levels) // 2] * len(values)
    top = len(levels) - 1
    return "".join(levels[round((v - low) / (high - low) * top)] for v in values)


def number(value: float) -> str:
    """A figure in at most six characters, its sign aside."""
    if value == 0:
        return "0"
    if 0.01 <= abs(value) < 1000:
        return f"{value:.3g}"
    return f"{value:.0e}".replace("e-0", "e-").replace("e+0", "e").replace("e+", "e")


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


def figure(value: float | None) -> str:
    """A figure with two decimals, or a dash where there is none."""
    return "-" if value is None else f"{value:.2f}"


def row(label: str, value: Text) -> Text:
    """A labelled line."""
    label = printable(label)
    if len(label) > LABEL:
        label = label[: LABEL - 1] + "…"
    return Text.assemble((f" {label:<{LABEL}} ", STYLES["label"]), value)
