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
"""Seconds that a design may take unless somebody grants it more."""


@contextmanager
def shown_progress(
    patience_s: float = PATIENCE_S, clock: Callable[[], float] = time.monotonic
) -> "Iterator[Progress]":
    """Progress on standard error, where the synthesis takes more than a second.

    Parameters
    ----------
    patience_s : float
        The design is refused once it has taken longer, with what to change.
    clock : callable
        Monotonic seconds.
    """
    from controller_service.sets.terminal import SynthesisError

    begin = clock()
    with shown("sets", clock=clock, slowing=True) as show:

        def advance(done: int, total: int) -> None:
            elapsed = clock() - begin
            if done < total and elapsed > patience_s:
                raise SynthesisError(
                    f"control.horizon: {done} of {total} sets took {elapsed:.0f} s, and each takes "
                    f"longer than the one before; control.horizon = {max(1, done)} would do, or "
                    f"`wyner design FILE --patience {10 * elapsed:.0f}`, once"
                )
            show(done, total)

        yield advance
