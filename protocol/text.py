"""Text to print: foreign text on one line without control characters, and tables."""

from collections.abc import Iterable, Sequence


def printable(text: str) -> str:
    """Text on one line. Control characters and what cannot be shown become ``·``."""
    return "".join(c if c.isprintable() else "·" for c in text)


def readable(payload: bytes) -> str:
    """A payload as one line of text: undecodable and unprintable characters as ``·``."""
    return printable(payload.decode("utf-8", errors="replace").replace("\ufffd", "·"))


def aligned(rows: Iterable[Sequence[str]]) -> list[str]:
    """The rows of a table as lines, a column's cells below each other."""
    table = list(rows)
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines = ("  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)) for row in table)
    return [line.rstrip() for line in lines]


class Shown:
    """Caches `readable` of the last payload."""

    def __init__(self) -> None:
        self._payload, self._text = b"", ""

    def text(self, payload: bytes) -> str:
        """The payload as one line of text."""
        if payload != self._payload:
            self._payload, self._text = payload, readable(payload)
        return self._text
