"""The ports of one end of one loop: its files, its publishers, its log."""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from protocol.link.effects import Effect, Extract, Notice, Publish, Save, Show, Tell
from protocol.link.events import lines
from protocol.messages import Message, Status
from protocol.secret.blocks import ClosedBlock
from runtime.bus import Publisher
from runtime.journal import ControllerJournal, PlantJournal
from runtime.logs import Burst, RateLimitedLog
from runtime.recording import TraceWriter


@dataclass(slots=True)
class Files:
    """Where one end of one loop leaves what it has to keep: journal, trace and status."""

    journal: ControllerJournal | PlantJournal
    trace: TraceWriter
    health: Path

    def close(self) -> None:
        """Close journal and trace."""
        try:
            self.trace.close()
        finally:
            self.journal.close()


class LoopPorts:
    """The ports of one end of one loop: its files, its publishers, its log.

    Parameters
    ----------
    files : Files
    publishers : dict
        By the type of message.
    log : logging.Logger
    tell_health : callable
        Has the status kept in the run's folder.
    extract : callable, optional
        Takes key blocks to be extracted.
    """

    def __init__(
        self,
        files: Files,
        publishers: dict[type[Message], Publisher],
        log: logging.Logger,
        tell_health: Callable[[Status], None],
        extract: Callable[[ClosedBlock], None] | None = None,
    ) -> None:
        self.files, self.publishers, self.log = files, publishers, log
        self._tell_health, self._extract = tell_health, extract
        self._limited: dict[str, RateLimitedLog] = {}
        self._burst = Burst()

    def do(self, effect: Effect) -> None:
        """Carry it out.

        The trace is on the disk before a save that is, and before one that counts a message whole.
        """
        match effect:
            case Save():
                if effect.durable or effect.received is not None:
                    self.files.trace.sync()
                self.files.journal.save(effect)
            case Publish(message):
                self.publishers[type(message)].put(message.wire())
            case Tell(event):
                self.files.trace.write(*lines(event))
            case Extract(block):
                assert self._extract is not None, "keys are made, and nothing extracts them"
                self._extract(block)
            case Notice():
                self.log_notice(effect)
            case Show(status):
                self._tell_health(status)
                self._report_held_back()

    def log_notice(self, notice: Notice) -> None:
        """Log it; with a subject, or after a burst of others, once a second at most."""
        if not notice.subject and self._burst.allows(time.monotonic()):
            self.log.log(_LEVELS[notice.level], "%s", notice.text)
            return
        subject = notice.subject or "lines"
        if subject not in self._limited:
            self._limited[subject] = RateLimitedLog(self.log)
        self._limited[subject].add(notice.text)

    def close(self) -> None:
        """Tell the rest of the log, and close the files."""
        self._report_held_back(last=True)
        self.files.close()

    def _report_held_back(self, *, last: bool = False) -> None:
        for limited in tuple(self._limited.values()):  # a flood is told beside the turns
            limited.report_held_back(last=last)


_LEVELS: Final = {"info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}
