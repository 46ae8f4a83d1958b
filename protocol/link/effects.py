"""What an end of the link asks of its shell: one class an effect.

An end gives them one by one, in the order in which they must happen, and goes on with its step when
one is done: so it counts a step while its partner already works on the message that it published
before. It saves what is about to be said before it says it.
"""

from collections.abc import Iterable
from typing import Literal, NamedTuple

from protocol.link.distiller import NO_ROWS, KeyRows
from protocol.link.events import Event
from protocol.link.records import ControllerRecord, PlantRecord
from protocol.link.step import IDLE, Step
from protocol.messages import Message, SendCommand, Status
from protocol.secret.blocks import ClosedBlock


class Save(NamedTuple):
    """Save all that the end must not forget, all or nothing; it then survives the process.

    Parameters
    ----------
    record : ControllerRecord or PlantRecord
        What came of all that went before.
    step : Step
        That follows the record: all it takes to count it again.
    rows : KeyRows
        Rows of key blocks and of the key stream that change; rows of another session than the
        record's go anyway.
    symbols : str
        Those of the frame under way that have left the plant's record.
    queued : SendCommand, optional
        A message for the controller's queue.
    received : bytes, optional
        The payload of a whole frame.
    durable : bool
        It must survive a power failure, too.
    """

    record: ControllerRecord | PlantRecord
    step: Step = IDLE
    rows: KeyRows = NO_ROWS
    symbols: str = ""
    queued: SendCommand | None = None
    received: bytes | None = None
    durable: bool = False


class Publish(NamedTuple):
    """Send a message, without waiting for anybody."""

    message: Message


class Tell(NamedTuple):
    """Write an event down for whoever checks the run.

    It comes before the save of what it tells: who dies in between tells it once more.
    """

    event: Event


class Extract(NamedTuple):
    """Have the keys of a block extracted, which no step waits for."""

    block: ClosedBlock


class Notice(NamedTuple):
    """A line for the log; those of one ``subject`` are logged once a second at most."""

    text: str
    level: Literal["info", "warning", "error"] = "info"
    subject: str = ""


class Show(NamedTuple):
    """Replace the status in the run's folder."""

    status: Status


Effect = Save | Publish | Tell | Extract | Notice | Show
Effects = Iterable[Effect]
