"""Says how far a design is, and ends one that takes too long.

Sets of three and four states grow: each takes longer than the one before. So sets are counted, and
the time elapsed is shown; nothing is said of the time left.
"""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from controller_service.sets.design import Progress

PATIENCE_S: Final = 60.0
"""Seconds that a design may take unless somebody grants it more."""

QUIET_S: Final = 1.0
"""A design that is done sooner shows nothing."""

REPEAT_S: Final = 0.1
LINES_S: Final = 10.0
"""Seconds between two shows of progress: on a terminal, and in a pipe."""


@contextmanager
def shown_progress(
    patience_s: float = PATIENCE_S, clock: Callable[[], float] = time.monotonic
) -> "Iterator[Progress]":
    """Progress on standard error, where the synthesis takes more than a second.

    On a terminal it is a line that changes, else a line every ten seconds.

    Parameters
    ----------
    patience_s : float
        The design is refused once it has taken longer, with what to change.
    clock : callable
        Monotonic seconds.
    """
    from controller_service.sets.terminal import SynthesisError

    terminal = sys.stderr.isatty()
    begin = clock()
    due = begin + QUIET_S
    shown = ""

    def advance(done: int, total: int) -> None:
        nonlocal due, shown
        now = clock()
        elapsed = now - begin
        if done < total and elapsed > patience_s:
            raise SynthesisError(
                f"control.horizon: {done} of {total} sets took {elapsed:.0f} s, and each takes "
                f"longer than the one before; control.horizon = {max(1, done)} would do, or "
                f"`wyner design FILE --patience {10 * elapsed:.0f}`, once"
            )
        if now < due:
            return
        due = now + (REPEAT_S if terminal else LINES_S)
        shown = f"wyner: sets: {done} of {total} after {elapsed:.0f} s"
        print(shown, end="\r" if terminal else "\n", file=sys.stderr, flush=True)

    try:
        yield advance
    finally:
        if terminal and shown:
            print(" " * len(shown), end="\r", file=sys.stderr, flush=True)
