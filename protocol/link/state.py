"""The state of an end: the step, and machines that own a frozen record each.

What is not in a record or in the step is lost with the process, and does not matter then.
"""

from abc import ABC, abstractmethod

from protocol.link.distiller import Distiller
from protocol.link.effects import Save
from protocol.link.records import ControllerRecord, LinkRecord, PlantRecord
from protocol.link.session import Rules
from protocol.link.step import Step
from protocol.messages import SendCommand
from protocol.secret.nonces import NonceSource
from protocol.secret.stream import Position


class EndState(ABC):
    """What both ends have.

    Parameters
    ----------
    rules : Rules
    record : ControllerRecord or PlantRecord
        As read back from the journal, or a first one.
    nonces : NonceSource

    Attributes
    ----------
    link : LinkRecord
    step : Step
        The step after all that the record counts.
    keys : Distiller
    now : float
        The time that it was told last.
    """

    step: Step

    def __init__(
        self,
        rules: Rules,
        record: ControllerRecord | PlantRecord,
        nonces: NonceSource,
        now: float,
    ) -> None:
        self.rules = rules
        self.link: LinkRecord = record.link._replace(state=rules.scheme.restore(record.link.state))
        self.keys = Distiller(rules.schedule, rules.size, nonces)
        self.now = now

    @property
    @abstractmethod
    def record(self) -> ControllerRecord | PlantRecord:
        """What the journal keeps of it beside the step."""

    def digits(self, position: Position) -> tuple[int, ...]:
        """The digits of the key stream that an offer names, where this end holds them."""
        count = self.rules.digits
        return (count and self.keys.stream.at(position, count)) or ()

    def save(
        self,
        symbols: str = "",
        queued: SendCommand | None = None,
        received: bytes | None = None,
        *,
        durable: bool = False,
    ) -> Save:
        """The record and the step as they are now, with the rows that change with them."""
        return Save(self.record, self.step, self.keys.rows(), symbols, queued, received, durable)
