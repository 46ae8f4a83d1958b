"""Extracts key blocks in a thread beside the service's, so no step waits for a matrix.

The thread works in NumPy, which lets the loop's threads run meanwhile. A block that is asked for
again gives the same tag and keys, so nothing is lost where the service dies: the block's rows are
in the journal.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

from protocol.secret.blocks import ClosedBlock, ExtractedBlock, ExtractionFailed

Tell = Callable[[ExtractedBlock | ExtractionFailed], None]


class Extraction:
    """One thread for all loops of a host; it starts at once, before there is a loop to disturb."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, "keys")
        self._pool.submit(_load)

    def put(self, block: ClosedBlock, tell: Tell) -> None:
        """Have a block extracted; ``tell`` is called with the result, in the thread."""
        with suppress(RuntimeError):  # it is closed: the next start asks again
            self._pool.submit(lambda: tell(_extracted(block)))

    def close(self) -> None:
        """End the thread; blocks that are not begun are asked for again by the next start."""
        self._pool.shutdown(wait=False, cancel_futures=True)


def _load() -> None:
    """Load the numerics, and compute the field's tables, before the first block comes."""
    from protocol.secret.galois import tables

    tables()


def _extracted(block: ClosedBlock) -> ExtractedBlock | ExtractionFailed:
    """The block's tag and keys, or why there will be none any more."""
    from protocol.secret.extractor import extracted

    try:
        return extracted(block)
    except (MemoryError, ValueError) as error:
        return ExtractionFailed(f"a key block cannot be extracted: {type(error).__name__}: {error}")
