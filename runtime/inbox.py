"""Where messages wait between the transport's thread and a service's own.

The library's ``queue.SimpleQueue`` is no substitute: its timed ``get`` can wait for ever. When the
thread is held up between fixing the deadline and looking at it again, the time that is left comes
out negative, and that is taken for no limit at all (CPython 3.11; a plant stood still for it).
"""

import queue
import threading
import time
from collections import deque
from contextlib import suppress
from typing import Final, Generic, TypeVar

T = TypeVar("T")

OVERHEAD: Final = 200
"""Bytes that an item costs beside its payload, about."""

ROOM: Final = 8 * 2**20
"""Bytes that wait at most, unless said otherwise."""


class Inbox(Generic[T]):
    """A queue for one thread that takes and any number that put, bounded in bytes.

    What comes when there is no room is dropped and counted: a flood costs messages, which the
    protocol survives, and not memory.

    Parameters
    ----------
    room : int
        Bytes of payload that may wait, with `OVERHEAD` for each item.

    Attributes
    ----------
    dropped : int
        Items for which there was no room.
    """

    def __init__(self, room: int = ROOM) -> None:
        self.room = room
        self.dropped = 0
        self._items: deque[tuple[T, int]] = deque()
        self._came = self._taken = 0
        self._putting = threading.Lock()
        self._filled = threading.Lock()  # released when something new may be there
        self._filled.acquire()

    def __len__(self) -> int:
        return len(self._items)

    def put(self, item: T, size: int | None) -> None:
        """Add an item whose payload has ``size`` bytes, or drop it; never waits.

        Without a size it is never dropped: for what a program tells itself.
        """
        cost = 0 if size is None else size + OVERHEAD
        with self._putting:
            if size is not None and self._came - self._taken + cost > self.room:
                self.dropped += 1
                return
            self._came += cost
        self._items.append((item, cost))
        with suppress(RuntimeError):  # released before, and nobody has looked since
            self._filled.release()

    def get(self, timeout: float) -> T:
        """Take the oldest item; wait for one up to ``timeout`` seconds.

        Raises
        ------
        queue.Empty
            When none has come.
        """
        until = time.monotonic() + timeout
        while not self._items:  # what was new may have been taken since
            if not self._filled.acquire(timeout=max(until - time.monotonic(), 0.0)):
                raise queue.Empty
        item, cost = self._items.popleft()
        self._taken += cost  # by the one thread that takes
        return item
