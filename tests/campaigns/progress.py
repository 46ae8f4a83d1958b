"""What the campaigns' commands share: for how long they go on, and their lines of progress."""

import sys
import time
from argparse import ArgumentParser
from collections.abc import Callable
from typing import Final

TOLD_S: Final = 15.0
"""Seconds between two lines of progress."""


def arguments(doc: str | None) -> ArgumentParser:
    """The parser of a campaign, which ends after ``--seconds``."""
    parser = ArgumentParser(description=doc)
    parser.add_argument("--seconds", type=float, default=float("inf"))
    return parser


class Progress:
    """Says whether ``seconds`` are not over yet, and tells meanwhile how far it came."""

    def __init__(self, seconds: float, told: Callable[[], object]) -> None:
        self._told, self._told_at = told, time.monotonic()
        self._until = self._told_at + seconds

    def goes_on(self) -> bool:
        """Whether there is time left."""
        now = time.monotonic()
        if now > self._told_at + TOLD_S:
            self._told_at = now
            print(self._told(), file=sys.stderr, flush=True)
        return now < self._until
