"""Extracts key blocks in a process beside the service, so no loop waits for a matrix.

A block that is asked for again gives the same tag and keys, so nothing is lost where the process
or the service dies: the block's rows are in the journal.
"""

import os
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from multiprocessing import get_context
from typing import Final

from protocol.secret.blocks import ClosedBlock, ExtractedBlock, ExtractionFailed
from runtime.child import die_with, ignore_signals, leave_no_image

NICENESS: Final = 10
"""The loop and its partner come first."""

TRIES: Final = 3
"""Deaths of the process over one block after which no more are extracted."""

Tell = Callable[[ExtractedBlock | ExtractionFailed], None]


class Extraction:
    """One process for all loops of a host; it starts at once, before there is a loop to disturb."""

    def __init__(self) -> None:
        self._pool = self._opened()

    def _opened(self) -> ProcessPoolExecutor:
        pool = ProcessPoolExecutor(
            max_workers=1,
            mp_context=get_context("spawn"),
            initializer=_begin,
            initargs=(os.getpid(),),
        )
        pool.submit(_load)
        return pool

    def put(self, block: ClosedBlock, tell: Tell, tries: int = TRIES) -> None:
        """Have a block extracted; ``tell`` is called with the result, in another thread."""

        def done(future: Future[ExtractedBlock]) -> None:
            if future.cancelled():
                return
            error = future.exception()
            if error is None:
                tell(future.result())
            elif isinstance(error, BrokenProcessPool) and tries > 1:
                self._pool = self._opened()
                self.put(block, tell, tries - 1)
            else:
                tell(ExtractionFailed(f"the process that extracts keys failed: {error}"))

        try:
            future = self._pool.submit(_extracted, block)
        except BrokenProcessPool:
            self._pool = self._opened()
            future = self._pool.submit(_extracted, block)
        except RuntimeError:  # it is closed: the next start asks again
            return
        future.add_done_callback(done)

    def close(self) -> None:
        """End the process; blocks that are not done are asked for again by the next start."""
        self._pool.shutdown(wait=False, cancel_futures=True)


def _load() -> None:
    """Compute the field's tables before the first block comes."""
    from protocol.secret.galois import tables

    tables()


def _extracted(block: ClosedBlock) -> ExtractedBlock:
    """In the process, which alone loads the numerics."""
    from protocol.secret.extractor import extracted

    return extracted(block)


def _begin(parent: int) -> None:
    """In the process: end with the service and not before, and step back for the loop."""
    ignore_signals()
    leave_no_image()
    die_with(parent)
    with suppress(OSError):
        os.nice(NICENESS)
