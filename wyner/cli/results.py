"""How every command prints what it found: as text, or as one object with ``--json``."""

import argparse
import json
from textwrap import fill
from typing import Final

from protocol.text import printable
from wyner.printout import Printout

WIDTH: Final = 79
"""Columns of a line, which is broken between words."""


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add ``--json``."""
    parser.add_argument("--json", action="store_true", help="one object on standard output")


def show(found: Printout, args: argparse.Namespace, *, indent: int = 2) -> None:
    """Print what was found; what a terminal would not show as text is spelled out.

    Parameters
    ----------
    found : Printout
    args : argparse.Namespace
        With ``json``.
    indent : int
        Columns before what does not fit into a line, on those below.
    """
    if args.json:
        print(json.dumps(found.figures))
        return
    for line in map(printable, str(found).split("\n")):
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
