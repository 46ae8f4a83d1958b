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
"""Seconds of a processor that a design may take in a command; the library has no limit."""


@contextmanager
def shown_progress(
    clock: Callable[[], float] = time.monotonic,
    processor: Callable[[], float] = time.process_time,
) -> "Iterator[Progress]":
    """Progress on standard error, where the synthesis takes more than a second.

    The design is refused once it has taken `PATIENCE_S`, with what to change.

    Parameters
    ----------
    clock : callable
        Monotonic seconds.
    processor : callable
        Seconds that this process has computed: a busy machine makes no design too large.
    """
    from controller_service.sets.terminal import SynthesisError

    begin = processor()
    with shown("sets", clock=clock, slowing=True) as show:

        def advance(done: int, total: int) -> None:
            spent = processor() - begin
            if done < total and spent > PATIENCE_S:
                raise SynthesisError(
                    f"control.horizon: {done} of {total} sets took {spent:.0f} s, and each takes "
                    f"longer than the one before; control.horizon = {max(1, done)} would do, or "
                    "compute it once in Python, which takes any time: wyner.design(FILE)"
                )
            show(done, total)

        yield advance
