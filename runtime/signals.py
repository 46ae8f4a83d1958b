"""Stopping: on a signal, or when standard input ends."""

import os
import signal
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from math import inf
from typing import Final

from runtime.errors import INTERRUPTED

POLL_S: Final = 0.2
"""Longest sleep in seconds of a program that only a signal can end."""

AT_ONCE_S: Final = 1.0
"""Seconds that a program has, after a second signal, to give back what it holds."""

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
    longer looks; and the process ends within :data:`AT_ONCE_S` of it, whatever its threads wait for
    by then.
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
        with _ended_by_a_second(ending):
            yield stopping
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _ended_by_a_second(ending: Sequence[int]) -> Iterator[None]:
    """End the process soon after a second signal, also where its main thread never comes back.

    Python's own handlers wait for that one; the numbers that it writes to a pipe do not.
    """
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    before = signal.set_wakeup_fd(writing, warn_on_full_buffer=False)

    over = threading.Event()

    def count() -> None:
        came = 0
        while numbers := os.read(reading, 16):
            came += sum(number in ending for number in numbers)
            if came > 1 and not over.wait(AT_ONCE_S):
                os._exit(INTERRUPTED)
        os.close(reading)

    threading.Thread(target=count, name="second signal", daemon=True).start()
    try:
        yield
    finally:
        over.set()
        signal.set_wakeup_fd(before)
        os.close(writing)


def _stop_at_end_of_stdin(stopping: threading.Event) -> None:
    while os.read(0, 4096):
        pass
    stopping.set()
