"""Words and figures: short numbers, sparklines, nothing that could move a cursor."""

import math
import unicodedata
from collections.abc import Sequence
from functools import lru_cache
from typing import Final

from rich.cells import cell_len

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
    "centre": "bold",
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


PHASES: Final[dict[tuple[str, str], str]] = {
    ("plant", "greeting"): "plant looks for a controller",
    ("controller", "greeting"): "controller looks for a plant",
}
"""What a service says of itself, in words."""


def in_words(service: str, phase: str) -> str:
    """A service's phase for people."""
    return PHASES.get((service, phase), f"{service} {phase}")


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
