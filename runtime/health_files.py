"""The status that each end writes into its folder once a second, and whether it keeps up.

It is for programs outside (:mod:`runtime.health` reads it), and no step waits for it: a thread
of its own writes it. One that takes a slow disk 100 ms would else cost every loop of the host a
step. One that cannot be written costs nothing but itself: it is logged, and tried again.

Its first field, ``health``, begins with ``ok`` or ``bad`` and says why, so that a health check
costs a shell's start and no interpreter's (``deploy/healthy``). A change is logged too, once: a
partner that was never there, or is frozen, gone or off the network, a machine too slow for its
pace, a disk nearly full.
"""

import logging
import queue
import shutil
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple

from pydantic_core import to_json

from protocol.messages import PlantStatus, Status
from runtime.files import StatusFile

WINDOW_S: Final = 10.0
"""Seconds over which missed steps are counted."""

SILENT_S: Final = 5.0
"""Seconds without a transition after which the loop stands still."""

STILL_S: Final = 2.0
"""Seconds without a transition that the line calls a standstill, not slowness."""

MISSED_AT_MOST: Final = 0.2
"""Share of missed steps above which an end does not keep up."""

FULL_BYTES: Final = 256 << 20
"""Free space below which a disk is nearly full; it is told again after twice as much was free."""


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
    still_s: float
    """How long nothing had moved before this beat's transitions."""


@dataclass(slots=True)
class Liveness:
    """Judges what an end counts; time is an argument.

    Slow: more than 20 % of the steps were missed in two consecutive looks, while transitions were
    made. Steps missed while nothing moves may be those of a partner that is gone, which is known
    after `SILENT_S`.
    """

    _seen: deque[_Seen] = field(default_factory=deque)
    _moved_s: float | None = None
    _missed_many: bool = False
    _trouble: str = ""
    _began_s: float | None = None

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
        if self._began_s is None:
            self._began_s = now_s
        last = self._seen[-1] if self._seen else None
        if last is not None and (transitions < last.transitions or missed < last.missed):
            self._seen.clear()
            last = None
        moved = transitions > (last.transitions if last is not None else 0)
        still_s = 0.0
        if moved:
            still_s = now_s - self._moved_s if self._moved_s is not None else 0.0
            self._moved_s = now_s
            if self._trouble == "silent":
                self._seen.clear()  # what was missed meanwhile is no slowness
                still_s = 0.0
        self._seen.append(_Seen(now_s, transitions, missed, still_s))
        while len(self._seen) > 2 and self._seen[1].at_s <= now_s - WINDOW_S:
            self._seen.popleft()
        first = self._seen[0]
        made, lost = transitions - first.transitions, missed - first.missed
        if self._moved_s is None:
            return self._not_begun(now_s - self._began_s, missed, meeting=meeting)
        silent_s = now_s - self._moved_s
        many = lost > MISSED_AT_MOST * (made + lost)
        slow = many and (self._missed_many if moved else self._trouble == "slow")
        if moved:
            self._missed_many = many
        if silent_s >= SILENT_S:
            trouble = "silent"
            why = (
                f"no transition for {silent_s:.0f} s: the other end is frozen, gone or off the "
                "network"
            )
        elif slow:
            trouble = "slow"
            stop_s = max(seen.still_s for seen in self._seen)
            why = f"{100 * lost // (made + lost)} % of the last {made + lost} steps missed: " + (
                f"the other end, its network or this machine stood still for about {stop_s:.0f} s"
                if stop_s >= STILL_S
                else "this machine or its network is too slow for the pace"
            )
        else:
            trouble, why = "", f"keeps up again, {transitions} transitions"
        notice = why if trouble != self._trouble else ""
        self._trouble = trouble
        if trouble:
            return LivenessReport(f"bad: {why}", notice)
        share = f"{100 * lost / (made + lost):.0f} %" if made + lost else "none"
        return LivenessReport(f"ok: {share} missed lately", notice, good=True)

    def _not_begun(self, waited_s: float, missed: int, *, meeting: bool) -> LivenessReport:
        """There is no transition yet; after :data:`SILENT_S` the log says what is waited for."""
        if meeting:
            trouble = "alone"
            why = (
                "waiting for the other end, which has not answered on the management bus: is it "
                "running, with the same --loop, and does one end connect where the other listens?"
            )
        else:
            trouble = "deaf"
            why = (
                f"no transition yet, {missed} steps missed: the other end answers on the management"
                " bus, and nothing, or too late, on the field bus: does one end connect there where"
                " the other listens, and is it fast enough for the pace?"
            )
        notice = why if waited_s >= SILENT_S and trouble != self._trouble else ""
        if notice:
            self._trouble = trouble
        return LivenessReport(f"bad: {why}", notice)


@dataclass(slots=True)
class DiskSpace:
    """Tells once that the disk below a folder is nearly full, and once that it is not any more."""

    folder: Path
    _full: bool = False

    def look(self) -> tuple[str, bool]:
        """A line for the log where something changed, and whether it is good news."""
        try:
            free = shutil.disk_usage(self.folder).free
        except OSError:
            return "", True
        if not self._full and free < FULL_BYTES:
            self._full = True
            return f"disk nearly full: {free >> 20} MiB left below {self.folder}", False
        if self._full and free > 2 * FULL_BYTES:
            self._full = False
            return f"room again: {free >> 20} MiB left below {self.folder}", True
        return "", True


class HealthFiles:
    """The status of one end of one loop, with its health, and what of both is worth a line.

    Parameters
    ----------
    path : Path
        Of the status.
    log : logging.Logger
    """

    def __init__(self, path: Path, log: logging.Logger) -> None:
        self._status = StatusFile(path)
        self._pulse = Liveness()
        self._space = DiskSpace(path.parent)
        self._unwritten = ""
        self.log = log

    def write(self, status: Status, now_s: float) -> None:
        """Replace the file, as of a monotonic time; a fault of the disk is logged, once.

        The status holds no text, key or coin: its readers need not be on the management bus.
        """
        missed = status.missed if isinstance(status, PlantStatus) else 0
        meeting = status.phase == "greeting"
        beat = self._pulse.beat(now_s, status.transitions, missed, meeting=meeting)
        for line, good in ((beat.notice, beat.good), self._space.look()):
            if line:
                self.log.log(logging.INFO if good else logging.WARNING, "%s", line)
        health = beat.line
        if self._unwritten:
            health = f"bad: this file could not be written until now: {self._unwritten}"
        body = b'{"health":%b,%b' % (to_json(health), status.on_file().removeprefix(b"{"))
        try:
            self._status.write(body)
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
        self._newest: dict[str, tuple[HealthFiles, Status, float]] = {}
        self._order: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None

    def put(self, loop: str, files: HealthFiles, status: Status) -> None:
        """Have a status written; returns at once. It takes the place of one that still waits."""
        with self._lock:
            if self._thread is None:
                thread = threading.Thread(target=self._run, name="health", daemon=True)
                thread.start()
                self._thread = thread  # started: close() joins no other
            if loop not in self._newest:
                self._order.put(loop)
            self._newest[loop] = files, status, time.monotonic()

    def close(self, within_s: float) -> None:
        """Write what waits, for so many seconds at most, and end."""
        if self._thread is not None:
            self._order.put(None)
            self._thread.join(within_s)

    def _run(self) -> None:
        while (loop := self._order.get()) is not None:
            with self._lock:
                files, status, at_s = self._newest.pop(loop)
            try:
                files.write(status, at_s)
            except Exception as error:  # whatever it is, the other loops' are written
                files.log.exception("the status is lost: %s", type(error).__name__)
