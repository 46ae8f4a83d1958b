"""The heavy eavesdroppers' process as the tap sees it: started, asked, ended."""

import logging
import multiprocessing
import os
import signal
import time
from collections.abc import Iterator
from multiprocessing import resource_tracker
from typing import Any

from protocol.messages import TapStatus
from tap_service.analysis import Assignment, analyse

Report = tuple[TapStatus, dict[str, Any]]
"""What one of them believes: as published, and as kept in ``beliefs.json``."""


class HeavyProcess:
    """Runs :func:`tap_service.analysis.analyse` beside the tap.

    Parameters
    ----------
    assignment : Assignment
    log : logging.Logger
        Where its end is told.
    """

    def __init__(self, assignment: Assignment, log: logging.Logger) -> None:
        self._log = log
        # one thread is all it may take of the processor
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self.process = context.Process(target=analyse, args=(assignment, theirs), daemon=True)
        # Ctrl-C in a terminal reaches both, and is not for the child, even before it runs. The
        # tracker would be started here too, and unblock the signal.
        resource_tracker.ensure_running()
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            self.process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        theirs.close()

    def reports(self) -> Iterator[Report]:
        """What it has told since the last time."""
        try:
            while not self.gone and self._pipe.poll():
                report = self._pipe.recv()
                if report is None:
                    return
                yield report
        except (EOFError, OSError):
            self._lost()

    @property
    def gone(self) -> bool:
        """Whether nothing comes from it any more."""
        return self._pipe.closed

    def finish(self, within_s: float) -> Iterator[Report]:
        """Its last reports, once it has read all that there is; it is ended if that takes long."""
        deadline = time.monotonic() + within_s
        try:
            self._pipe.send("finish")
            while (left := deadline - time.monotonic()) > 0:
                if not self._pipe.poll(left):
                    break
                report = self._pipe.recv()
                if report is None:
                    self._pipe.close()
                    return
                yield report
        except (EOFError, OSError):
            self._lost()
            return
        self._log.error("the heavy eavesdroppers did not finish within %g s", within_s)
        self.process.terminate()

    def _lost(self) -> None:
        self._log.error("the heavy eavesdroppers' process is gone")
        self._pipe.close()

    def close(self) -> None:
        """End it."""
        self._pipe.close()
        self.process.join(1.0)
        if self.process.is_alive():
            self.process.terminate()
            self.process.join(1.0)
