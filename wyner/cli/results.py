"""How every command prints what it found: as text, or as one object with ``--json``."""

import argparse
import json
from typing import Any, Protocol

from protocol.text import printable


class Result(Protocol):
    """What a function of the library found; ``str`` of it is the text for people."""

    def to_json(self) -> dict[str, Any]:
        """The same for programs."""
        ...


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add ``--json``."""
    parser.add_argument("--json", action="store_true", help="one object on standard output")


def show(result: Result, args: argparse.Namespace) -> None:
    """Print a result; what a terminal would not show as text is spelled out."""
    if args.json:
        print(json.dumps(result.to_json()))
    else:
        print("\n".join(map(printable, str(result).split("\n"))))
