"""Shows on standard error how far long work is, and about how long it still takes."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

Advance = Callable[[int, int], None]
"""Takes how much is done, and how much there is."""

QUIET_S: Final = 1.0
"""Work that is done sooner shows nothing."""

REPEAT_S: Final = 0.1
LINES_S: Final = 10.0
"""Seconds between two shows of progress: on a terminal, and in a pipe."""


def duration(seconds: float) -> str:
    """A time to wait, to two figures that matter."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h" if seconds < 360_000 else "days"


@contextmanager
def shown(
    what: str, *, clock: Callable[[], float] = time.monotonic, slowing: bool = False
) -> Iterator[Advance]:
    """A line that changes on a terminal, else a line every ten seconds.

    The estimate is the time that the rest takes at the pace so far.

    Parameters
    ----------
    what : str
        The parts that are counted.
    clock : callable
        Monotonic seconds.
    slowing : bool
        Each part takes longer than the one before: the estimate is a lower bound.
    """
    terminal = sys.stderr.isatty()
    begin = clock()
    due = begin + QUIET_S
    first: int | None = None
    line = ""

    def advance(done: int, total: int) -> None:
        nonlocal due, first, line
        now = clock()
        first = done if first is None else first
        if now < due:
            return
        due = now + (REPEAT_S if terminal else LINES_S)
        before, elapsed = line, now - begin
        line = f"wyner: {what}: {done} of {total} after {duration(elapsed)}"
        if done > first:
            left = duration(elapsed * (total - done) / (done - first))
            line += f", {'at least' if slowing else 'about'} {left} left"
        end = " " * (len(before) - len(line)) + "\r" if terminal else "\n"
        print(line, end=end, file=sys.stderr, flush=True)

    try:
        yield advance
    finally:
        if terminal and line:
            print(" " * len(line), end="\r", file=sys.stderr, flush=True)
