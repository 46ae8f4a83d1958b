"""The status that each end writes into its folder once a second, and whether it keeps up.

It is for programs outside (``deploy/healthy``, ``wyner status``), and no step waits for it: a
thread of its own writes it. One that takes a slow disk 100 ms would else cost every loop of the
host a step. One that cannot be written costs nothing but itself: it is logged, and tried again.

Its first field, ``health``, begins with ``ok`` or ``bad`` and says why, so that a health check
costs a shell's start and no interpreter's. A change is logged too, once.
"""

import logging
import queue
import threading
import time
from collections import deque
from pathlib import Path
from typing import Final, NamedTuple

from pydantic_core import to_json

from protocol.messages import PlantStatus, Status
from runtime.status_file import StatusFile

WINDOW_S: Final = 10.0
"""Seconds over which missed steps are counted."""

SILENT_S: Final = 5.0
"""Seconds without a transition after which the loop stands still."""

MISSED_AT_MOST: Final = 0.2
"""Share of missed steps above which an end does not keep up."""

SLOW: Final = "slow"
SILENT: Final = (
    "no transition for {s:.0f} s: the other end is frozen, gone or off the network",
    "no transition yet, {missed} steps missed: the other end answers on the management bus, and "
    "nothing, or too late, on the field bus: does one end connect there where the other listens, "
    "and is it fast enough for the pace?",
    "waiting for the other end, which has not answered on the management bus: is it running, with "
    "the same --loop, and does one end connect where the other listens?",
)
"""Why nothing moves: once the loop has moved, with a partner, and without one."""


class LivenessReport(NamedTuple):
    """The line for the status, and a line for the log where something changed."""

    line: str
    notice: str
    good: bool = False
    """Whether the notice is good news."""


class _Seen(NamedTuple):
    at_s: float
    transitions: int
    missed: int


class Liveness:
    """Judges what an end counts; time is an argument.

    Steps missed while nothing moves are those of a partner that is gone, which is known after
    `SILENT_S`; so slowness is judged where something has moved.
    """

    def __init__(self) -> None:
        self._seen: deque[_Seen] = deque()
        self._still_since: float | None = None
        self._begun = False
        self._trouble = ""

    def beat(
        self, now_s: float, transitions: int, missed: int, *, meeting: bool = False
    ) -> LivenessReport:
        """Judge the counts at a monotonic time.

        Parameters
        ----------
        now_s : float
        transitions, missed : int
            Counted since the record began; a new session may count from 0 again.
        meeting : bool
            Whether no partner has taken part in the session yet.
        """
        last = self._seen[-1] if self._seen else _Seen(now_s, 0, 0)
        moved = transitions > last.transitions
        if (
            transitions < last.transitions
            or missed < last.missed
            or (moved and self._trouble in SILENT)
        ):
            self._seen.clear()  # what was missed meanwhile is no slowness
        if moved or self._still_since is None:
            self._still_since = now_s
        self._begun |= moved
        self._seen.append(_Seen(now_s, transitions, missed))
        while len(self._seen) > 2 and self._seen[1].at_s <= now_s - WINDOW_S:
            self._seen.popleft()
        first, still_s = self._seen[0], now_s - self._still_since
        made, lost = transitions - first.transitions, missed - first.missed
        slow = lost > MISSED_AT_MOST * (made + lost) and (moved or self._trouble == SLOW)
        trouble, why = "", f"keeps up again, {transitions} transitions"
        if still_s >= SILENT_S or not self._begun:
            trouble = SILENT[0 if self._begun else 1 + meeting]
            why = trouble.format(s=still_s, missed=missed)
        elif slow:
            trouble = SLOW
            why = (
                f"{100 * lost // (made + lost)} % of the last {made + lost} steps missed: the other"
                " end, its network or this machine is too slow for the pace, or stood still"
            )
        changed = trouble != self._trouble and (self._begun or still_s >= SILENT_S)
        if changed:
            self._trouble = trouble
        notice = why if changed else ""
        if trouble:
            return LivenessReport(f"bad: {why}", notice)
        share = f"{100 * lost / (made + lost):.0f} %" if made + lost else "none"
        return LivenessReport(f"ok: {share} missed lately", notice, good=True)


class HealthFiles:
    """The status of one end of one loop, with its health, and what of both is worth a line.

    Parameters
    ----------
    path : Path
        Of the status.
    log : logging.Logger
    """

    def __init__(self, path: Path, log: logging.Logger) -> None:
        self._file = StatusFile(path)
        self._pulse = Liveness()
        self._unwritten = ""
        self.log = log

    def write(self, status: Status, now_s: float) -> None:
        """Replace the file, as of a monotonic time; a fault of the disk is logged, once.

        The status holds no text, key or coin: its readers need not be on the management bus.
        """
        missed = status.step.missed if isinstance(status, PlantStatus) else 0
        meeting = status.phase == "greeting"
        beat = self._pulse.beat(now_s, status.step.transitions, missed, meeting=meeting)
        if beat.notice:
            self.log.log(logging.INFO if beat.good else logging.WARNING, "%s", beat.notice)
        health = beat.line
        if self._unwritten:
            health = f"bad: this file could not be written until now: {self._unwritten}"
        body = b'{"health":%b,%b' % (to_json(health), status.on_file().removeprefix(b"{"))
        try:
            self._file.write(body)
        except OSError as error:
            why = f"{error.filename or ''}: {error.strerror}"
            if why != self._unwritten:
                self.log.error("%s: the loop goes on, and the status is tried again", why)
            self._unwritten = why
        else:
            if self._unwritten:
                self.log.info("the status is written again")
            self._unwritten = ""


class HealthWriter:
    """Writes the statuses of any number of loops, of each the newest."""

    def __init__(self) -> None:
        self._newest: dict[HealthFiles, tuple[Status, float]] = {}
        self._order: queue.SimpleQueue[HealthFiles | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None

    def put(self, files: HealthFiles, status: Status) -> None:
        """Have a status written; returns at once. It takes the place of one that still waits."""
        with self._lock:
            if self._thread is None:
                thread = threading.Thread(target=self._run, name="health", daemon=True)
                thread.start()
                self._thread = thread  # started: close() joins no other
            if files not in self._newest:
                self._order.put(files)
            self._newest[files] = status, time.monotonic()

    def close(self, within_s: float) -> None:
        """Write what waits, for so many seconds at most, and end."""
        if self._thread is not None:
            self._order.put(None)
            self._thread.join(within_s)

    def _run(self) -> None:
        while (files := self._order.get()) is not None:
            with self._lock:
                status, at_s = self._newest.pop(files)
            try:
                files.write(status, at_s)
            except Exception as error:  # whatever it is, the other loops' are written
                files.log.exception("the status is lost: %s", type(error).__name__)
