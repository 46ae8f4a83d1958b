"""An end of the link as its shell sees it: sans I/O, with its timers.

Messages and the time go in, :class:`Actions` come out. Who carries them out, and in which order,
stands in :mod:`runtime.perform`; no other module knows it. The two endpoints are
:mod:`controller_service.core` and :mod:`plant_service.core`.
"""

from typing import Final, Literal, NamedTuple, Protocol

from protocol.link.events import Event
from protocol.link.records import ReceiverRecord, SenderRecord, Step
from protocol.messages import Message, Status
from protocol.secret.nonces import Contribution
from protocol.secret.tasks import Done, Task


class Save(NamedTuple):
    """A record for the journal, with what came along, all or nothing.

    ``later``: the next :class:`Step` takes it along; until then nothing is lost, for it can be
    counted again. ``chunk`` has symbols of the frame under way that have left the plant's record,
    ``drop_chunks`` says that this frame is over, ``received`` is the payload of a whole frame.
    ``queued`` is a message for the controller's queue, after its identifier. ``contribution`` is
    the row of a transition for its key block, ``obsolete_rows`` names transitions whose rows may
    go; rows of another session than the record's go anyway.
    """

    record: SenderRecord | ReceiverRecord
    later: bool = False
    chunk: str = ""
    drop_chunks: bool = False
    received: bytes | None = None
    queued: tuple[str, bytes] | None = None
    contribution: Contribution | None = None
    obsolete_rows: tuple[range, ...] = ()

    @property
    def for_tables(self) -> bool:
        """Whether it has more than a record and rows: messages or symbols, in tables of theirs."""
        more = self.queued is not None or self.received is not None
        return more or bool(self.chunk) or self.drop_chunks


Write = Step | Save
"""What a journal is given: a step, kept beside the record before it, or the record after it."""


class Notice(NamedTuple):
    """A line for the log; those of one ``subject`` are logged once a second at most."""

    text: str
    level: Literal["info", "warning", "error"] = "info"
    subject: str = ""


class Actions(NamedTuple):
    """What a shell must do after an endpoint heard something or woke.

    ``events`` are traced before ``write`` is written: who dies in between counts them, and traces
    them, once more. ``keys`` are tasks for the key maker, which no step waits for. ``health``
    is the status of which the run's folder keeps what a file may. ``finish_step`` asks for
    :meth:`Peer.finish_step`, once everything else is done.
    """

    events: tuple[Event, ...] = ()
    write: Write | None = None
    publish: tuple[Message, ...] = ()
    notices: tuple[Notice, ...] = ()
    health: Status | None = None
    finish_step: bool = False
    keys: tuple[Task, ...] = ()


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
