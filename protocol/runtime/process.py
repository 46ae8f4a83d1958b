"""What the programs share: exit codes, one-line errors, signals, logging, pace."""

import gc
import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from math import inf
from typing import Final

from protocol.text import printable

DONE: Final = 0
FAILED: Final = 1
USAGE: Final = 2
INTERRUPTED: Final = 130

LOOK_S: Final = 0.2
"""Longest sleep of a program that nothing but a signal can end."""

STOP_WITH_STDIN: Final = "WYNER_STOP_WITH_STDIN"
"""Environment variable: a service started with it stops when its standard input ends, and so never
outlives the program that holds the other end, however that one died."""


class UsageError(Exception):
    """Bad usage or configuration, exit code 2; ``lines`` has one line for each wrong field."""

    def __init__(self, lines: Sequence[str] | str) -> None:
        self.lines = (lines,) if isinstance(lines, str) else tuple(lines)
        super().__init__("\n".join(self.lines))


class Failure(Exception):
    """Something that was asked for could not be done, exit code 1; the text is one line."""


class Stop(threading.Event):
    """A request to stop that a signal's handler may make wherever the program stands.

    Python runs the handler in the main thread, once that one runs. The kernel may hand the signal
    to another thread of the process, as it does where threads are being started, and then a main
    thread that waits for a lock sleeps on. And a handler that takes the lock of the event that
    its own thread is about to wait for waits for itself. So whoever waits here looks again every
    `LOOK_S`, and nothing is locked.
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
            time.sleep(min(left, LOOK_S))
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


class _Printable(logging.Formatter):
    """A line stays a line, and no terminal obeys it: what a message holds may be a stranger's."""

    def format(self, record: logging.LogRecord) -> str:
        """The record with everything unprintable as a dot; a traceback keeps its lines."""
        return "\n".join(map(printable, super().format(record).splitlines()))


def logger(service: str) -> logging.Logger:
    """The log of a program: lines on standard error with the time and the program's name."""
    log = logging.getLogger(service)
    if not log.handlers:
        handler = logging.StreamHandler(sys.stderr)
        formatter = _Printable("%(asctime)s %(name)s %(levelname)s %(message)s")
        formatter.default_msec_format = "%s.%03d"
        handler.setFormatter(formatter)
        log.addHandler(handler)
        log.setLevel(logging.INFO)
        log.propagate = False
    return log


class Throttle:
    """Says when something may happen again: at most once in ``period_s`` seconds."""

    def __init__(self, period_s: float) -> None:
        self.period_s = period_s
        self._next = 0.0

    def ready(self, now_s: float) -> bool:
        """Whether the period is over at monotonic time ``now_s``; if so it begins anew."""
        if now_s < self._next:
            return False
        self._next = now_s + self.period_s
        return True


class Burst:
    """Lets a few through at once, and after them one a period on average (a token bucket).

    Parameters
    ----------
    most : int
        At once.
    period_s : float
    """

    def __init__(self, most: int = 30, period_s: float = 1.0) -> None:
        self._most = most
        self._period_s = period_s
        self._left = float(most)
        self._at = 0.0

    def allows(self, now_s: float) -> bool:
        """Whether one more may pass at monotonic time ``now_s``; if so it counts."""
        refilled = self._left + (now_s - self._at) / self._period_s
        self._left, self._at = min(refilled, float(self._most)), now_s
        if self._left < 1:
            return False
        self._left -= 1
        return True


class RateLimitedLog:
    """Counts what goes wrong and logs it once a second at most, with the count since."""

    def __init__(self, log: logging.Logger) -> None:
        self.total = 0
        self._log = log
        self._silent = 0
        self._throttle = Throttle(1.0)

    def add(self, text: str) -> None:
        """Count one more, and log it unless one was logged within the last second."""
        self.total += 1
        if self._throttle.ready(time.monotonic()):
            more = f" (and {self._silent} more since the last such line)" if self._silent else ""
            self._log.warning("%s%s", text, more)
            self._silent = 0
        else:
            self._silent += 1


@contextmanager
def reading(what: str) -> Iterator[None]:
    """Where a file's fields are taken as their writer left them: one that is otherwise is one line.

    Set ``WYNER_TRACEBACK=1`` to see what it was.

    Raises
    ------
    UsageError
        In place of what a missing, malformed or senseless field raises.
    """
    try:
        yield
    except (ArithmeticError, LookupError, TypeError, ValueError) as error:
        if os.environ.get("WYNER_TRACEBACK"):
            raise
        why = f"{type(error).__name__}: {error}".split("\n")[0]
        raise UsageError(f"{what}: not as this program writes it ({why})") from None


class Pace:
    """How fast plant time passes: ``realtime``, ``xN`` times that, or ``fast`` (lock-step).

    Parameters
    ----------
    text : str
        As the user writes it.

    Raises
    ------
    ValueError
        When it is none of the three.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        self.factor: float | None
        if text == "fast":
            self.factor = None
        elif text == "realtime":
            self.factor = 1.0
        else:
            try:
                self.factor = float(text.removeprefix("x")) if text.startswith("x") else 0.0
            except ValueError:
                self.factor = 0.0
            if not 0 < self.factor < float("inf"):
                raise ValueError(f"got {text!r}, expected realtime, fast, or xN such as x10")

    def step_s(self, period_s: float) -> float | None:
        """Seconds of wall time in a step of ``period_s`` seconds; None in lock-step."""
        return None if self.factor is None else period_s / self.factor


_NEVER: Final = 2**31 - 1
"""Collections of the middle generation before one of the oldest."""

_GROWN: Final = 50_000
"""Containers by which a service grows before what is young is searched for garbage."""


def freeze_startup() -> None:
    """Take what a service has loaded out of garbage collection, once, before its loop begins.

    Modules, schemas and the design live as long as the process; searching them again and again
    made a control step a sixth longer. After that a search pays only where garbage in circles
    comes, and a loop makes none. Python counts what is made less what is let go: where windows
    roll, 700 more are there only every 18 s, but all that was made since then and lives is young,
    and with 200 loops searching it stopped a host for 20 to 50 ms. So it is searched once a
    service has grown by `_GROWN`, and what has grown old is not.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(_GROWN, gc.get_threshold()[1], _NEVER)


def needs(what: str, package: str) -> str:
    """One line: ``what`` asks for a package that is not there, and how this very Python gets it."""
    return f"{what}: needs {package}: {sys.executable} -m pip install {package}"


def new_id() -> str:
    """A random id of 64 bits, as 16 hexadecimal digits."""
    return os.urandom(8).hex()


_CONSONANTS: Final = "bdfghjklmnprstvz"
_VOWELS: Final = "aiou"


def proquint(fingerprint: str, words: int = 4) -> str:
    """The first ``words`` 16-bit groups of a hexadecimal fingerprint as words a person can compare.

    The encoding is that of proquints (Wilkerson, arXiv:0901.4016): consonant and vowel in turn.
    """
    groups = []
    for i in range(words):
        value = int(fingerprint[4 * i : 4 * i + 4], 16)
        groups.append(
            _CONSONANTS[value >> 12]
            + _VOWELS[value >> 10 & 3]
            + _CONSONANTS[value >> 6 & 15]
            + _VOWELS[value >> 4 & 3]
            + _CONSONANTS[value & 15]
        )
    return "-".join(groups)
