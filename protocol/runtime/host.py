"""The shell: any number of endpoints on two buses, in one process.

What comes is put on one queue by the transport's threads; one thread takes it off, wakes whoever
is due, and carries out what the endpoints ask for. A service is a host with one endpoint.
"""

import heapq
import logging
import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from math import inf
from pathlib import Path
from typing import Final, Protocol

from pydantic_core import from_json

from protocol.link.endpoint import Actions, Endpoint, Notice, Write
from protocol.link.events import Event
from protocol.link.perform import perform
from protocol.messages import Measurement, Message, Offer
from protocol.runtime.bus import Bus, Publisher
from protocol.runtime.inbox import Inbox
from protocol.runtime.process import DONE, Burst, Complaints
from protocol.runtime.pulse import Pulse, Space
from protocol.runtime.run_folder import HEALTH, write_atomically
from protocol.runtime.trace import TraceWriter
from protocol.secret.blocks import Stored
from protocol.secret.keeper import Keeper
from protocol.secret.tasks import Broken, Done, Judged, Task
from protocol.secret.worker import KeyWorker
from protocol.topics import key_of

LOOK_S: Final = 0.1
"""Longest wait before the loop looks at its signals again."""

FIELD: Final = frozenset({Measurement, Offer})
"""What travels on the field bus; all else is on ops."""


Heard = tuple[type[Message], bytes] | Done


class Journal(Protocol):
    """What :func:`protocol.link.perform.perform` writes to."""

    def write(self, write: Write) -> None:
        """Keep it."""

    def close(self) -> None:
        """Close it; it can be opened again."""


@dataclass(slots=True)
class Files:
    """Where one end of one loop leaves what it has to keep: journal, trace and status."""

    journal: Journal
    trace: TraceWriter
    health: Path
    keeper: Keeper | None = None

    def close(self) -> None:
        """Close journal and trace."""
        try:
            self.trace.close()
        finally:
            self.journal.close()


@dataclass(slots=True)
class LoopPorts:
    """The ports of one end of one loop: its files, its publishers, its log."""

    files: Files
    publishers: dict[type[Message], Publisher]
    log: logging.Logger
    worker: KeyWorker | None = None
    limited: dict[str, Complaints] = field(default_factory=dict)
    pulse: Pulse = field(default_factory=Pulse)
    space: Space | None = None
    burst: Burst = field(default_factory=Burst)

    def write(self, write: Write) -> None:
        """Write to the journal."""
        self.files.journal.write(write)

    def publish(self, kind: type[Message], payload: bytes) -> None:
        """Put it on the bus that its type belongs to."""
        self.publishers[kind].put(payload)

    def trace(self, event: Event) -> None:
        """Append to the trace."""
        self.files.trace.write(event.as_event())

    def keep(self, task: Task) -> None:
        """Hand it to the thread that keeps keys."""
        assert self.worker is not None, "keys are made, and nobody keeps them"
        self.worker.put(task)

    def tell(self, notice: Notice) -> None:
        """Log it; with a subject once a second at most."""
        if not notice.subject:
            if self.burst.allows(time.monotonic()):
                self.log.log(_LEVELS[notice.level], "%s", notice.text)
            else:
                self._limited("lines").add(notice.text)
            return
        self._limited(notice.subject).add(notice.text)

    def _limited(self, subject: str) -> Complaints:
        if subject not in self.limited:
            self.limited[subject] = Complaints(self.log)
        return self.limited[subject]

    def health(self, status: bytes) -> None:
        """Replace the status file and the line beside it that says whether this end keeps up."""
        write_atomically(self.files.health, status)
        told = from_json(status)
        beat = self.pulse.beat(time.monotonic(), told["transitions"], told.get("missed", 0))
        folder = self.files.health.parent
        write_atomically(folder / HEALTH, f"{beat.line}\n".encode())
        if self.space is None:
            self.space = Space(folder)
        for line in (beat.notice, self.space.look()):
            if line:
                self.log.warning("%s", line)


_LEVELS: Final = {"info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}


@dataclass(slots=True)
class _Loop:
    endpoint: Endpoint
    ports: LoopPorts
    wakes_at: float = inf  # the earliest entry of the heap that is this one's


class Host:
    """Runs endpoints until they are over, or until it is told to stop.

    Parameters
    ----------
    field_bus, ops : Bus
        Already open; closed by whoever opened them.
    stopping : threading.Event
        Ends :meth:`run`.
    clock : callable
        Monotonic seconds.
    """

    def __init__(
        self,
        field_bus: Bus,
        ops: Bus,
        stopping: threading.Event,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._field, self._ops = field_bus, ops
        self._stopping = stopping
        self._clock = clock
        self._loops: list[_Loop] = []
        self._wakes: list[tuple[float, int]] = []
        self._inbox: Inbox[tuple[int, Heard]] = Inbox()
        self._dropped = 0
        self._code = DONE
        self._living = 0

    def add(self, loop: str, endpoint: Endpoint, files: Files, log: logging.Logger) -> None:
        """Take in one more end, under the id of its loop; its files are closed with the host."""
        number = len(self._loops)

        def arrived(kind: type[Message], _key: str, payload: bytes, _t_ns: int) -> None:
            self._inbox.put((number, (kind, payload)), len(payload))

        publishers = {kind: self._bus(kind).publisher(key_of(kind, loop)) for kind in endpoint.says}
        worker = None
        if files.keeper is not None:
            worker = KeyWorker(files.keeper, lambda done: self._inbox.put((number, done), None))
        self._loops.append(_Loop(endpoint, LoopPorts(files, publishers, log, worker)))
        for kind in endpoint.hears:
            self._bus(kind).subscribe(key_of(kind, loop), partial(arrived, kind))
        self._living += 1

    def _bus(self, kind: type[Message]) -> Bus:
        return self._field if kind in FIELD else self._ops

    def run(self) -> int:
        """Run until stopped, or until every end is over; returns the exit code.

        Raises
        ------
        Failure, OSError, TransportError
            Whatever an endpoint, a file or a bus cannot go on after.
        """
        try:
            for number, loop in enumerate(self._loops):
                self._perform(number, loop.endpoint.start(self._clock()))
            while self._living and not self._stopping.is_set():
                self._wake()
                self._take(self._wakes[0][0] if self._wakes else inf)
        finally:
            self.close()
        return self._code

    def _wake(self) -> None:
        """Wake all who are due."""
        now = self._clock()
        while self._wakes and self._wakes[0][0] <= now:
            at, number = heapq.heappop(self._wakes)
            loop = self._loops[number]
            if at == loop.wakes_at and loop.endpoint.code is None:  # else overtaken by an earlier
                loop.wakes_at = inf
                if loop.endpoint.wake_at() <= now:
                    self._perform(number, loop.endpoint.wake(now))
                else:
                    self._schedule(number, loop)

    def _take(self, until: float) -> None:
        """Wait for a message, and hand it over."""
        wait_s = min(max(until - self._clock(), 0.0), LOOK_S)
        try:
            number, heard = self._inbox.get(timeout=wait_s)
        except queue.Empty:
            return
        if self._inbox.dropped > self._dropped:
            text = f"messages come faster than they are taken: {self._inbox.dropped} dropped so far"
            self._loops[number].ports.tell(Notice(text, "warning", "flood"))
            self._dropped = self._inbox.dropped
        endpoint = self._loops[number].endpoint
        if endpoint.code is not None:
            return
        if isinstance(heard, Stored | Judged | Broken):
            self._perform(number, endpoint.kept(heard, self._clock()))
        else:
            self._perform(number, endpoint.receive(*heard, self._clock()))

    def _perform(self, number: int, actions: Actions) -> None:
        loop = self._loops[number]
        perform(actions, loop.endpoint, loop.ports)
        code = loop.endpoint.code
        if code is None:
            self._schedule(number, loop)
        else:
            self._living -= 1
            self._code = max(self._code, code)

    def _schedule(self, number: int, loop: _Loop) -> None:
        due = loop.endpoint.wake_at()
        if due < loop.wakes_at:
            loop.wakes_at = due
            heapq.heappush(self._wakes, (due, number))

    def close(self) -> None:
        """Say the last word of every end, and close its files."""
        now = self._clock()
        for loop in self._loops:
            try:
                perform(loop.endpoint.stop(now), loop.endpoint, loop.ports)
            except OSError as error:
                loop.ports.log.warning("the last status is lost: %s", error)
            finally:
                if loop.ports.worker is not None:
                    loop.ports.worker.close()
                loop.ports.files.close()
