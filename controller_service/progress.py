"""Says how far a design is, and ends one that takes too long.

Sets of three and four states grow: each takes longer than the one before.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

from runtime.progress import shown

if TYPE_CHECKING:
    from controller_service.sets.design import Progress

PATIENCE_S: Final = 60.0
"""Seconds that a design may take in a command; the library's `design` takes any time."""


@contextmanager
def shown_progress(clock: Callable[[], float] = time.monotonic) -> "Iterator[Progress]":
    """Progress on standard error, where the synthesis takes more than a second.

    The design is refused once it has taken `PATIENCE_S`, with what to change.

    Parameters
    ----------
    clock : callable
        Monotonic seconds.
    """
    from controller_service.sets.terminal import SynthesisError

    begin = clock()
    with shown("sets", clock=clock, slowing=True) as show:

        def advance(done: int, total: int) -> None:
            elapsed = clock() - begin
            if done < total and elapsed > PATIENCE_S:
                raise SynthesisError(
                    f"control.horizon: {done} of {total} sets took {elapsed:.0f} s, and each takes "
                    f"longer than the one before; control.horizon = {max(1, done)} would do, or "
                    "compute it once in Python, which takes any time: wyner.design(FILE)"
                )
            show(done, total)

        yield advance
