"""How every command prints what it found: as text, or as one object with ``--json``."""

import argparse
import json
from textwrap import fill
from typing import Any, Final, Protocol

from protocol.text import printable

WIDTH: Final = 79
"""Columns of a line, which is broken between words."""


class Printable(Protocol):
    """What a function of the library found; ``str`` of it is the text for people."""

    def to_json(self) -> dict[str, Any]:
        """The same for programs."""
        ...


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add ``--json``."""
    parser.add_argument("--json", action="store_true", help="one object on standard output")


def show(result: Printable, args: argparse.Namespace, *, indent: int = 2) -> None:
    """Print a result; what a terminal would not show as text is spelled out.

    Parameters
    ----------
    result : Printable
    args : argparse.Namespace
        With ``json``.
    indent : int
        Columns before what does not fit into a line, on those below.
    """
    if args.json:
        print(json.dumps(result.to_json()))
        return
    for line in map(printable, str(result).split("\n")):
        print(folded(line, indent))


def folded(line: str, indent: int) -> str:
    """A line broken between words, and nowhere else: a path stays whole."""
    return fill(
        line,
        WIDTH,
        subsequent_indent=" " * indent,
        break_long_words=False,
        break_on_hyphens=False,
    )
