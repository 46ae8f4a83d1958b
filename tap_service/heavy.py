"""The heavy eavesdroppers' process as the tap sees it: started, asked, started again, ended.

A process that died looks from outside like one that has nothing new to say. So its end is noticed,
told, and mended: another is started, which reads the capture from its beginning, up to
:data:`RESTARTS` times.
"""

import logging
import time
from collections.abc import Iterator
from typing import Any, Final

from protocol.messages import TapStatus
from runtime.child import Child
from tap_service.analysis import Assignment

Report = tuple[TapStatus, dict[str, Any]]
"""What one of them believes: as published, and as kept in ``beliefs.json``."""

RESTARTS: Final = 3
"""Times that it is started again; whoever dies that often dies of what she hears."""

REST_S: Final = 1.0
"""Seconds before it is started again, doubled each time: memory may be short for a while."""


class HeavyProcess:
    """Runs :mod:`tap_service.analysis` beside the tap.

    Attributes
    ----------
    down : str
        Why nobody runs there now, as ``her process died (signal 9)``; empty while it does.
    process : Child
        The last one that was started.

    Parameters
    ----------
    assignment : Assignment
    log : logging.Logger
        Where its end is told.
    """

    def __init__(self, assignment: Assignment, log: logging.Logger) -> None:
        self._assignment = assignment
        self._log = log
        self._deaths = 0
        self._starts = 0
        self._again_at = 0.0
        self._start()

    def _start(self) -> None:
        self.down = ""
        self._done = False
        self._starts += 1
        self.process = Child("tap_service.analysis")
        try:
            self.process.line.send(self._assignment)
        except OSError:
            self._died()

    @property
    def restarts(self) -> int:
        """Times that the process was started again."""
        return self._starts - 1

    def reports(self) -> Iterator[Report]:
        """What it has told since the last time; one that died is started again when it is time."""
        if self.down and self._deaths <= RESTARTS and time.monotonic() >= self._again_at:
            self._start()
        try:
            while not (self.down or self._done) and self.process.line.poll():
                report = self.process.line.recv()
                if report is None:
                    self._done = True
                    return
                yield report
        except (EOFError, OSError):
            self._died()

    def finish(self, within_s: float) -> Iterator[Report]:
        """Its last reports, once it has read all that there is; it is ended if that takes long.

        One that is down, or dies, is started again where it may be and there is time.
        """
        deadline = time.monotonic() + within_s
        while (left := deadline - time.monotonic()) > 0:
            if self.down:
                if self._deaths > RESTARTS:
                    return
                time.sleep(min(left, max(0.0, self._again_at - time.monotonic())))
                if time.monotonic() >= deadline:
                    break
                self._start()
            try:
                line = self.process.line
                line.send("finish")
                while (left := deadline - time.monotonic()) > 0 and line.poll(left):
                    report = line.recv()
                    if report is None:
                        self._done = True
                        return
                    yield report
            except (EOFError, OSError):
                self._died()
        self._log.error("the heavy eavesdroppers did not finish within %g s", within_s)
        self.process.end(0.0)

    def _died(self) -> None:
        code = self.process.end()
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        self.down = f"her process died ({how})"
        self._deaths += 1
        self._again_at = time.monotonic() + REST_S * 2 ** (self._deaths - 1)
        told = "it is started again, and reads the capture from its beginning"
        if self._deaths > RESTARTS:
            told = f"it died {self._deaths} times, and is not started again"
        self._log.error("the heavy eavesdroppers' process died (%s): %s", how, told)

    def close(self) -> None:
        """End it."""
        self.process.end()
