"""An end of the link as its shell sees it: sans I/O, with its timers.

Messages and the time go in, effects come out (:mod:`protocol.link.effects`), which
:mod:`runtime.perform` carries out. The two ends are :mod:`controller_service.core` and
:mod:`plant_service.core`.
"""

from abc import ABC, abstractmethod
from typing import Any, ClassVar

from pydantic import ValidationError

from protocol.link.channel import Channel, UnderWay
from protocol.link.effects import Effects, Notice, Publish, Show
from protocol.link.key_events import appeared, extraction_done
from protocol.link.state import EndState
from protocol.link.telemetry import Telemetry
from protocol.messages import Message
from protocol.secret.blocks import ExtractedBlock, ExtractionFailed


class Endpoint(ABC):
    """One end of one loop. All times are seconds of one monotonic clock.

    What it asks for comes one by one, and it goes on only when the one before is done. So whoever
    calls it carries out everything before it calls it again.

    Parameters
    ----------
    instance : str
        Random id of this process.
    state : EndState
    channel : Channel, optional
        What messages of the field bus pass before they arrive.

    Attributes
    ----------
    code : int or None
        The exit code once this end is over; None as long as it goes on.
    malformed : int
        Messages that were none.
    """

    receives: ClassVar[tuple[type[Message], ...]]
    """The message types that it takes."""

    sends: ClassVar[tuple[type[Message], ...]]

    state: EndState
    news: Telemetry

    def __init__(self, instance: str, channel: Channel | None) -> None:
        self.instance = instance
        self.code: int | None = None
        self.malformed = 0
        self._network = None if channel is None else UnderWay(channel)

    # --- messages ---------------------------------------------------------------------------------

    def receive(self, kind: type[Message], payload: bytes, now: float) -> Effects:
        """A message reached this end, or the network before it; a malformed one is counted."""
        if kind not in self.receives:
            raise TypeError(f"{kind.__name__}: expected one of {self.receives}")
        try:  # what is received, and that alone: a wrong message of this end's own is a fault in it
            message = kind.from_wire(payload)
        except ValidationError as error:
            return self.reject(f"{kind.topic}: {error.error_count()} fields not as expected")
        if self._network is not None and self._network.takes(message, now):
            return ()
        return self.hear(message, now)

    def reject(self, what: str) -> Effects:
        """A message is malformed: it is counted, and changes nothing."""
        self.malformed += 1
        return (Notice(f"{what}; ignored", "warning", "malformed"),)

    @abstractmethod
    def hear(self, message: Message, now: float) -> Effects:
        """A message is there."""

    # --- time -------------------------------------------------------------------------------------

    def wake_at(self) -> float:
        """When :meth:`wake` is due: the earliest of all timers."""
        due = self.due_at()
        return due if self._network is None else min(due, self._network.due_at)

    def wake(self, now: float) -> Effects:
        """The message that is due, or whatever of the end's was due before it."""
        network = self._network
        if network is not None and network.due_at <= now and network.due_at < self.due_at():
            return self.hear(network.arrived(), now)
        return self.act(now)

    @abstractmethod
    def due_at(self) -> float:
        """The earliest of this end's own timers."""

    @abstractmethod
    def act(self, now: float) -> Effects:
        """Do what is due at ``now``."""

    # --- from its first to its last word ----------------------------------------------------------

    @abstractmethod
    def start(self, now: float) -> Effects:
        """The first messages, and the step that the journal holds uncounted."""

    @abstractmethod
    def stop(self, now: float) -> Effects:
        """The last status; the process ends."""

    # --- keys -------------------------------------------------------------------------------------

    @property
    def makes_keys(self) -> bool:
        """Whether it has key blocks to be extracted."""
        return self.state.keys.on

    def extracted(self, block: ExtractedBlock | ExtractionFailed) -> Effects:
        """A key block is extracted, or none can be any more."""
        return extraction_done(self.state.keys, block)

    def appear(self, count: int) -> Effects:
        """From now on a message on the field bus leaves ``count`` times."""
        record = self.state.record
        return appeared(self.state.keys, record.session.id, record.link.k, count)

    # --- the status -------------------------------------------------------------------------------

    def publish_status(self) -> Effects:
        """A status to publish, and once a second to be kept; nothing where none is asked for."""
        news = self.news
        if news.status_s is None:
            return
        messages = news.messages(self.state, self.malformed)
        yield from map(Publish, messages)
        if news.health_is_due(self.state.now):
            status: Any = messages[-1]
            yield Show(status)
