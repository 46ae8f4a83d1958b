"""The log of a program, and a limit of one line a second for what may come in floods."""

import logging
import sys
import time

from protocol.text import printable


class _Printable(logging.Formatter):
    """Prints a record on one line without control characters: a message may hold foreign text."""

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


class Burst:
    """Lets a few through at once, and after them so many a second on average (a token bucket).

    Parameters
    ----------
    most : float
        At once.
    rate_hz : float
    """

    def __init__(self, most: float = 30.0, rate_hz: float = 1.0) -> None:
        self._most = most
        self._rate_hz = rate_hz
        self._left = most
        self._at = 0.0

    def allows(self, now_s: float) -> bool:
        """Whether one more may pass at monotonic time ``now_s``; if so it counts."""
        refilled = min(self._left + (now_s - self._at) * self._rate_hz, self._most)
        if refilled < 1:
            return False
        self._left, self._at = refilled - 1, now_s
        return True


class RateLimitedLog:
    """Counts what goes wrong and logs it once a second at most, with the count since.

    The owner calls :meth:`report_held_back` now and then and at its end.
    """

    def __init__(self, log: logging.Logger) -> None:
        self.total = 0
        self._log = log
        self._text = ""
        self._untold = 0
        self._limit = Burst(1, 1.0)

    def add(self, text: str) -> None:
        """Count one more, and log it unless one was logged within the last second."""
        self.total += 1
        self._text = text
        self._untold += 1
        self.report_held_back()

    def report_held_back(self, *, last: bool = False) -> None:
        """Log the newest that was not logged, with the count before it, once the second is over.

        Parameters
        ----------
        last : bool
            At once, for there is no later.
        """
        if self._untold and (last or self._limit.allows(time.monotonic())):
            before = self._untold - 1
            more = f" (and {before} more since the last such line)" if before else ""
            self._log.warning("%s%s", self._text, more)
            self._untold = 0
