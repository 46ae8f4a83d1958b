"""An end of the link as its shell sees it: sans I/O, with its timers.

Messages and the time go in, :class:`Actions` come out. Who carries them out, and in which order,
stands in :mod:`runtime.perform`; no other module knows it. The two endpoints are
:mod:`controller_service.core` and :mod:`plant_service.core`.
"""

from typing import Final, Literal, NamedTuple, Protocol

from protocol.agreement import NO_SYMBOL
from protocol.link.events import Event
from protocol.link.records import ReceiverRecord, SenderRecord
from protocol.messages import Measurement, Message, Offer, SendCommand, Status
from protocol.secret.nonces import Contribution
from protocol.secret.tasks import Done, Task


class Notice(NamedTuple):
    """A line for the log; those of one ``subject`` are logged once a second at most."""

    text: str
    level: Literal["info", "warning", "error"] = "info"
    subject: str = ""


class Actions(NamedTuple):
    """What a shell must do after an endpoint heard something or woke.

    ``events`` are traced before anything is saved: who dies in between counts them, and traces
    them, once more. ``keys`` are tasks for the key maker, which no step waits for. ``health``
    is the status of which the run's folder keeps what a file may. ``finish_step`` asks for
    :meth:`Peer.finish_step`, once everything else is done.

    What is saved is saved all or nothing. ``record`` is all that the end must not forget; ``later``
    says that it may wait for the next step: until then nothing is lost, for it can be counted
    again. ``offer``, ``coin`` and ``measurement`` are the step that follows the record: all it
    takes to count it again. Where there is no ``record`` it follows the one saved last. At the
    plant ``measurement`` reports the step that ``offer`` led to, and ``coin`` is b_r, the number of
    the candidate chosen; a plant that cannot make a step twice saves its coin before it acts, with
    no measurement yet. At the controller ``offer`` answers ``measurement``, and there is no coin.

    The rest comes along with a record. ``queued`` is a message for the controller's queue,
    ``received`` the payload of a whole frame. ``chunk`` has symbols of the frame under way that
    have left the plant's record, ``drop_chunks`` says that this frame is over. ``contribution`` is
    the row of a transition for its key block, ``obsolete_rows`` names transitions whose rows may
    go; rows of another session than the record's go anyway.
    """

    events: tuple[Event, ...] = ()
    record: SenderRecord | ReceiverRecord | None = None
    later: bool = False
    offer: Offer | None = None
    coin: int = NO_SYMBOL
    measurement: Measurement | None = None
    queued: SendCommand | None = None
    received: bytes | None = None
    chunk: str = ""
    drop_chunks: bool = False
    contribution: Contribution | None = None
    obsolete_rows: tuple[range, ...] = ()
    publish: tuple[Message, ...] = ()
    notices: tuple[Notice, ...] = ()
    health: Status | None = None
    finish_step: bool = False
    keys: tuple[Task, ...] = ()

    @property
    def saves(self) -> bool:
        """Whether there is anything to save."""
        return self.record is not None or self.offer is not None

    @property
    def for_tables(self) -> bool:
        """Whether more than rows comes along: messages or symbols, in tables of theirs."""
        more = self.queued is not None or self.received is not None
        return more or bool(self.chunk) or self.drop_chunks


NOTHING_TO_DO: Final = Actions()


class Peer(Protocol):
    """One end of one loop. All times are seconds of one monotonic clock."""

    hears: tuple[type[Message], ...]
    """The message types that it takes."""

    says: tuple[type[Message], ...]

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

    def key_task_done(self, done: Done, now: float) -> Actions:
        """The key maker has done one of its tasks."""

    def appear(self, count: int) -> Actions:
        """From now on a message on the field bus leaves ``count`` times."""

    def stop(self, now: float) -> Actions:
        """The last status; the process ends."""
