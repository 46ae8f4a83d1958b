"""Stopping: on a signal, or when standard input ends."""

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from math import inf
from typing import Final

POLL_S: Final = 0.2
"""Longest sleep in seconds of a program that only a signal can end."""

STOP_WITH_STDIN: Final = "WYNER_STOP_WITH_STDIN"
"""Environment variable: a service started with it stops when its standard input ends, and so never
outlives the program that holds the other end, however that one died."""


class Stop(threading.Event):
    """A request to stop that a signal's handler may make wherever the program stands.

    Python runs the handler in the main thread, once that one runs. The kernel may hand the signal
    to another thread of the process, as it does where threads are being started, and then a main
    thread that waits for a lock sleeps on. And a handler that takes the lock of the event that
    its own thread is about to wait for waits for itself. So whoever waits here looks again every
    `POLL_S`, and nothing is locked.
    """

    def __init__(self) -> None:
        super().__init__()
        self._asked = False

    def is_set(self) -> bool:
        """Whether the program shall stop."""
        return self._asked

    def set(self) -> None:
        """Ask the program to stop."""
        self._asked = True

    def wait(self, timeout: float | None = None) -> bool:
        """Sleep until the program shall stop, for so many seconds at most; whether it shall."""
        until = inf if timeout is None else time.monotonic() + timeout
        while not self._asked and (left := until - time.monotonic()) > 0:
            time.sleep(min(left, POLL_S))
        return self._asked


@contextmanager
def stop_on_signals() -> Iterator[threading.Event]:
    """Turn SIGTERM, SIGINT and SIGHUP into an event that the program's loop looks at.

    A second signal of these is a KeyboardInterrupt where the program stands, for a loop that no
    longer looks.
    """
    stopping = Stop()

    def stop(_signal: int, _frame: object) -> None:
        if stopping.is_set():
            raise KeyboardInterrupt
        stopping.set()

    if os.environ.get(STOP_WITH_STDIN):
        threading.Thread(target=_stop_at_end_of_stdin, args=(stopping,), daemon=True).start()
    ending = [signal.SIGTERM, signal.SIGINT]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # nohup has it ignored
        ending.append(signal.SIGHUP)
    before = {number: signal.signal(number, stop) for number in ending}
    try:
        yield stopping
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _stop_at_end_of_stdin(stopping: threading.Event) -> None:
    while os.read(0, 4096):
        pass
    stopping.set()
