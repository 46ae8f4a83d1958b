"""How far a design is, on a terminal."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from controller_service.sets.design import Progress

PATIENCE_S: Final = 1.0
"""A synthesis that ends sooner shows nothing."""

REPEAT_S: Final = 0.1


@contextmanager
def shown_progress() -> "Iterator[Progress | None]":
    """A line on a terminal's standard error once the synthesis has taken a second."""
    if not sys.stderr.isatty():
        yield None
        return
    due = time.monotonic() + PATIENCE_S
    width = 0

    def advance(done: int, total: int) -> None:
        nonlocal due, width
        now = time.monotonic()
        if now >= due:
            due = now + REPEAT_S
            line = f"sets: {done} of {total}"
            width = max(width, len(line))
            print(f"\r{line:<{width}}", end="", file=sys.stderr, flush=True)

    try:
        yield advance
    finally:
        if width:
            print(f"\r{'':<{width}}\r", end="", file=sys.stderr, flush=True)
