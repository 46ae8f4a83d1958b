"""An end of the link as its shell sees it: sans I/O, with its timers.

Messages and the time go in, :class:`Actions` come out. Who carries them out, and in which order,
stands in :mod:`runtime.perform`; no other module knows it. The two endpoints are
:mod:`controller_service.core` and :mod:`plant_service.core`.
"""

from typing import Final, Literal, NamedTuple, Protocol

from protocol.agreement import NO_SYMBOL
from protocol.link.distiller import NO_ROWS, KeyRows
from protocol.link.events import Event
from protocol.link.records import ReceiverRecord, SenderRecord
from protocol.messages import Measurement, Message, Offer, SendCommand, Status
from protocol.secret.blocks import ClosedBlock, ExtractedBlock, ExtractionFailed


class Notice(NamedTuple):
    """A line for the log; those of one ``subject`` are logged once a second at most."""

    text: str
    level: Literal["info", "warning", "error"] = "info"
    subject: str = ""


class Actions(NamedTuple):
    """What a shell must do after an endpoint heard something or woke.

    ``events`` are traced before anything is saved: who dies in between counts them, and traces
    them, once more. ``tasks`` are key blocks to be extracted, which no step waits for. ``health``
    is the status of which the run's folder keeps what a file may. ``finish_step`` asks for
    :meth:`Peer.finish_step`, once everything else is done.

    Where there is a ``record``, it is saved: all that the end must not forget, and what comes along
    with it, all or nothing. A save survives the death of the process; one that is ``durable``
    survives a power failure, too. ``offer``, ``coin`` and ``measurement`` are the step that follows
    the record: all it takes to count it again, so what is counted is saved with the next step. At
    the plant ``measurement`` reports the step that ``offer`` led to, and ``coin`` is b_r, the
    number of the candidate chosen; a plant that cannot make a step twice saves its coin before it
    acts, with no measurement yet. At the controller ``offer`` answers ``measurement``, and there is
    no coin.

    ``queued`` is a message for the controller's queue, ``received`` the payload of a whole frame.
    ``symbols`` are those of the frame under way that have left the plant's record.
    ``rows`` are those of key blocks and of the key stream that change; rows of another session than
    the record's go anyway.
    """

    events: tuple[Event, ...] = ()
    record: SenderRecord | ReceiverRecord | None = None
    offer: Offer | None = None
    coin: int = NO_SYMBOL
    measurement: Measurement | None = None
    queued: SendCommand | None = None
    received: bytes | None = None
    symbols: str = ""
    rows: KeyRows = NO_ROWS
    durable: bool = False
    publish: tuple[Message, ...] = ()
    notices: tuple[Notice, ...] = ()
    health: Status | None = None
    finish_step: bool = False
    tasks: tuple[ClosedBlock, ...] = ()


NOTHING_TO_DO: Final = Actions()


class Peer(Protocol):
    """One end of one loop. All times are seconds of one monotonic clock."""

    hears: tuple[type[Message], ...]
    """The message types that it takes."""

    says: tuple[type[Message], ...]

    @property
    def makes_keys(self) -> bool:
        """Whether it has key blocks to be extracted."""

    @property
    def code(self) -> int | None:
        """The exit code once this end is over; None as long as it goes on."""

    def start(self, now: float) -> Actions:
        """The first messages, and the step that the journal holds uncounted."""

    def receive(self, kind: type[Message], payload: bytes, now: float) -> Actions:
        """A message came; a malformed one is counted, and changes nothing."""

    def wake_at(self) -> float:
        """When :meth:`wake` is due: the earliest of all timers."""

    def wake(self, now: float) -> Actions:
        """Do what is due at ``now``."""

    def finish_step(self) -> Actions:
        """What can wait until the message is on its way, while the partner works on it."""

    def extracted(self, block: ExtractedBlock | ExtractionFailed) -> Actions:
        """A key block is extracted, or none can be any more."""

    def appear(self, count: int) -> Actions:
        """From now on a message on the field bus leaves ``count`` times."""

    def stop(self, now: float) -> Actions:
        """The last status; the process ends."""
