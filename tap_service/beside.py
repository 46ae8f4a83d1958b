"""A process beside the mirror, as the tap sees it: started, asked, started again, ended.

The heavy eavesdroppers of the ladder share one, and each eavesdropper of a user has one of its own,
which is bounded. All of them read the capture (:mod:`tap_service.analysis`), so the mirror never
waits for them.

A process that died looks from outside like one that has nothing new to say. So its end is noticed
and told. The ladder's is started again, and reads the capture from its beginning, up to
:data:`RESTARTS` times; a user's has failed.
"""

import logging
import signal
import time
from collections.abc import Iterator
from typing import Final

from pydantic_core import from_json

from protocol.messages import TapStatus
from runtime.child import ChildProcess
from runtime.run_folder import ANALYSIS_GUESSES
from tap_service.analysis import Assignment
from tap_service.config import TapConfig, eighth, runs_beside
from tap_service.eavesdroppers import LADDER, named
from tap_service.status import Report, absent

RESTARTS: Final = 3
"""Times that the ladder's is started again: one that dies that often dies of what it hears."""

REST_S: Final = 1.0
"""Seconds before it is started again, doubled each time: memory may be short for a while."""


ANSWER_S: Final = 15.0
"""Seconds that a user's eavesdropper has for an answer."""

DYING_S: Final = 0.5
"""Seconds that one whose line is closed has to end by itself; the mirror waits."""


def assignments_of(config: TapConfig) -> list[Assignment]:
    """What runs beside the mirror: the ladder's heavy ones together, each of a user's alone."""
    found = []
    heavy = [name for name in config.names if name in LADDER and runs_beside(name)]
    own = [name for name in config.names if name not in LADDER]
    groups = [heavy, *([name] for name in own)]
    for number, names in enumerate(groups):
        if names:
            found.append(
                Assignment(
                    config.run_dir,
                    ANALYSIS_GUESSES.with_stem(f"analysis-{number}" if number else "analysis"),
                    {name: config.knowledge_of(name) for name in names},
                    eighth(config.limits),
                    config.header(),
                    answer_s=ANSWER_S if number else 0.0,
                )
            )
    return found


class Beside:
    """Runs :mod:`tap_service.analysis` beside the tap.

    Attributes
    ----------
    down : str
        Why nobody runs there now, as ``its process died (signal 9)``; empty while somebody does.
    process : ChildProcess
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
        self._names = tuple(named(name).name for name in assignment.told)
        self._newest: dict[str, tuple[Report, int]] = {}
        self._deaths = 0
        self._starts = 0
        self._again_at = 0.0
        self._finishing = False
        self._start()

    def _start(self) -> None:
        self.down = ""
        self._done = False
        self._starts += 1
        self.process = ChildProcess("tap_service.analysis")
        try:
            self.process.line.send(self._assignment)
            if self._finishing:
                self.process.line.send("finish")
        except OSError:
            self._died()

    @property
    def _given_up(self) -> bool:
        return self.down != "" and (self._assignment.answer_s > 0 or self._deaths > RESTARTS)

    def reports(self, captured: int) -> Iterator[Report]:
        """What each told last, when ``captured`` messages are recorded.

        What was captured since then nobody there has looked at, as far as is known.
        """
        self._start_when_due()
        while self._take(0.0, captured):
            pass
        for name in self._names:
            if name in self._newest or self.down:
                (status, record), then = self._newest.get(name) or (absent(name), 0)
                behind = status.behind + max(captured - then, 0) // 2
                unused = status.unused.model_copy(update={"restarts": self._starts - 1})
                its: dict[str, object] = {"behind": behind, "unused": unused}
                if self.down:
                    its["failed"] = self.down
                    record = record | {"symbols": None}
                yield status.model_copy(update=its), record

    def finish(self) -> None:
        """Tell it that nothing more will be captured."""
        self._finishing = True
        try:
            if not self.down:
                self.process.line.send("finish")
        except OSError:
            self._died()

    def last_reports(self, deadline: float, captured: int) -> Iterator[None]:
        """Take its last reports, until it has read all that there is; stops at each.

        It is ended if that takes beyond the ``deadline``. One that dies is started again, where it
        may be and there is time.
        """
        while not (self._done or self._given_up):
            left = deadline - time.monotonic()
            if left <= 0:
                self._log.error("%s did not finish in time", ", ".join(self._names))
                self._done = True
                self.process.end(0.0)
                return
            if self.down:
                time.sleep(min(left, max(0.0, self._again_at - time.monotonic())))
                self._start_when_due()
            elif self._take(left, captured):
                yield

    def _start_when_due(self) -> None:
        if self.down and not self._given_up and time.monotonic() >= self._again_at:
            self._start()

    def _take(self, within_s: float, captured: int) -> bool:
        """Take the next report, if one comes in time."""
        if self.down or self._done:
            return False
        try:
            if not self.process.poll(within_s):
                return False
            told = from_json(self.process.line.recv_bytes())
            if told is None:
                self._done = True
                return False
            status = TapStatus.model_validate_json(told["status"])
            self._newest[status.name] = (status, dict(told["record"])), captured
        except (EOFError, OSError, ValueError, LookupError, TypeError):
            self._died()
            return False
        return True

    def _died(self) -> None:
        code = self.process.end(DYING_S)
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        self.down = f"its process died ({how})"
        if code == -signal.SIGALRM:
            self.down = f"too slow: no answer within {self._assignment.answer_s:g} s"
        self._deaths += 1
        self._again_at = time.monotonic() + REST_S * 2 ** (self._deaths - 1)
        told = "it is started again, and reads the capture from its beginning"
        if self._given_up:
            told = f"it died {self._deaths} times, and is not started again"
        names = ", ".join(self._names)
        self._log.error("the process of %s died (%s): %s", names, self.down, told)

    def close(self) -> None:
        """End it."""
        self.process.end()
