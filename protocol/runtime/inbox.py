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
from typing import Generic, TypeVar

T = TypeVar("T")


class Inbox(Generic[T]):
    """A queue for one thread that takes and any number that put."""

    def __init__(self) -> None:
        self._items: deque[T] = deque()
        self._news = threading.Lock()  # released when something new may be there
        self._news.acquire()

    def __len__(self) -> int:
        return len(self._items)

    def put(self, item: T) -> None:
        """Add an item; never waits."""
        self._items.append(item)
        with suppress(RuntimeError):  # released before, and nobody has looked since
            self._news.release()

    def get(self, timeout: float) -> T:
        """Take the oldest item; wait for one up to ``timeout`` seconds.

        Raises
        ------
        queue.Empty
            When none has come.
        """
        if self._items:
            return self._items.popleft()
        until = time.monotonic() + timeout
        while self._news.acquire(timeout=max(until - time.monotonic(), 0.0)):
            if self._items:  # not so when what was new then has been taken since
                return self._items.popleft()
        raise queue.Empty
