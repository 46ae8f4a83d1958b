"""The ports of one end of one loop: its files, its publishers, its log, its key maker."""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Protocol

from protocol.link.events import Event
from protocol.link.peer import Notice, Write
from protocol.messages import Message, Status
from protocol.secret.tasks import Task
from runtime.bus import Publisher
from runtime.keys.key_maker import KeyMakerAt
from runtime.logs import RateLimitedLog
from runtime.rates import Burst
from runtime.recording import TraceWriter


class Journal(Protocol):
    """What :func:`runtime.perform.perform` writes to."""

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
    key_maker: KeyMakerAt | None = None

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
    tell_health: Callable[[Status], None]
    key_maker: Callable[[Task], None] | None = None
    limited: dict[str, RateLimitedLog] = field(default_factory=dict)
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

    def submit_key_task(self, task: Task) -> None:
        """Hand it to whoever keeps keys."""
        assert self.key_maker is not None, "keys are made, and nobody keeps them"
        self.key_maker(task)

    def log_notice(self, notice: Notice) -> None:
        """Log it; with a subject once a second at most."""
        if not notice.subject:
            if self.burst.allows(time.monotonic()):
                self.log.log(_LEVELS[notice.level], "%s", notice.text)
            else:
                self._limited("lines").add(notice.text)
            return
        self._limited(notice.subject).add(notice.text)

    def _limited(self, subject: str) -> RateLimitedLog:
        if subject not in self.limited:
            self.limited[subject] = RateLimitedLog(self.log)
        return self.limited[subject]

    def health(self, status: Status) -> None:
        """Have the status and the health line replaced; tell what the log still owes."""
        self.tell_health(status)
        for limited in tuple(self.limited.values()):  # a flood is told beside the turns
            limited.tell_rest()

    def close(self) -> None:
        """Tell the rest of the log, and close the files."""
        for limited in self.limited.values():
            limited.tell_rest(last=True)
        self.files.close()


_LEVELS: Final = {"info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}
