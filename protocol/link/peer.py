"""An end of the link as its shell sees it: sans I/O, with its timers.

Messages and the time go in, effects come out (:mod:`protocol.link.effects`), which
:mod:`runtime.perform` carries out. The two ends are :mod:`controller_service.core` and
:mod:`plant_service.core`.
"""

from typing import Protocol

from protocol.link.effects import Effects
from protocol.messages import Message
from protocol.secret.blocks import ExtractedBlock, ExtractionFailed


class Peer(Protocol):
    """One end of one loop. All times are seconds of one monotonic clock.

    What it asks for comes one by one, and it goes on only when the one before is done. So whoever
    calls it carries out everything before it calls it again.
    """

    hears: tuple[type[Message], ...]
    """The message types that it takes."""

    says: tuple[type[Message], ...]

    @property
    def makes_keys(self) -> bool:
        """Whether it has key blocks to be extracted."""

    @property
    def code(self) -> int | None:
        """The exit code once this end is over; None as long as it goes on."""

    def start(self, now: float) -> Effects:
        """The first messages, and the step that the journal holds uncounted."""

    def receive(self, kind: type[Message], payload: bytes, now: float) -> Effects:
        """A message came; a malformed one is counted, and changes nothing."""

    def wake_at(self) -> float:
        """When :meth:`wake` is due: the earliest of all timers."""

    def wake(self, now: float) -> Effects:
        """Do what is due at ``now``."""

    def extracted(self, block: ExtractedBlock | ExtractionFailed) -> Effects:
        """A key block is extracted, or none can be any more."""

    def appear(self, count: int) -> Effects:
        """From now on a message on the field bus leaves ``count`` times."""

    def stop(self, now: float) -> Effects:
        """The last status; the process ends."""
