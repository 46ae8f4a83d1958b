"""The controller's end as a state: the step under way, and machines that own a record each."""

from controller_service.outbox import MessageQueue
from controller_service.outgoing import Outgoing
from protocol.link.controller_session import ControllerSession
from protocol.link.records import ControllerRecord, LinkRecord, Loaded
from protocol.link.session import Rules
from protocol.link.state import EndState
from protocol.link.step import Answered, Begun, Idle, Read
from protocol.secret.nonces import NonceSource
from protocol.secret.stream import NOWHERE, Position
from protocol.streams import SymbolSource


class ControllerState(EndState):
    """All that the controller's end has of its loop.

    Parameters
    ----------
    rules, record, nonces, now
        As of :class:`protocol.link.state.EndState`.
    loaded : Loaded
        What the journal has besides.
    instance : str
        Random id of this process.
    period_s : float
        The plant's.
    messages : MessageQueue
    fresh : SymbolSource
        Random cipher symbols.

    Attributes
    ----------
    session : ControllerSession
    offer : Offer or None
        The one answer that may still be applied.
    frame : Outgoing
    alarms : AlarmRecord
    """

    step: Idle | Answered

    def __init__(
        self,
        rules: Rules,
        record: ControllerRecord,
        loaded: Loaded[ControllerRecord],
        nonces: NonceSource,
        now: float,
        instance: str,
        period_s: float,
        messages: MessageQueue,
        fresh: SymbolSource,
    ) -> None:
        super().__init__(rules, record, nonces, now)
        assert not isinstance(loaded.step, Begun | Read)
        self.step = loaded.step
        self.session = ControllerSession(instance, rules.fingerprint, record.session, period_s)
        self.offer, self.alarms = record.offer, record.alarms
        self.frame = Outgoing(rules, messages, fresh, record.frame)
        self.messages = messages
        newest = self.step.offer if isinstance(self.step, Answered) else self.offer
        named = NOWHERE if newest is None else newest.position
        after = Position(named.block, named.at + rules.digits)
        session = record.session.id or ""
        self.keys.resume(session, record.keys, loaded.rows, loaded.held, after)

    @property
    def record(self) -> ControllerRecord:
        """What the journal keeps of it beside the step."""
        session, frame, keys = self.session.record, self.frame.record, self.keys.record
        return ControllerRecord(session, self.link, self.offer, frame, self.alarms, keys)

    def begin_session(self, session: str | None) -> None:
        """Go on with another session, or with none: all that was agreed is dropped."""
        self.session.begin(session)
        self.link = LinkRecord(state=self.rules.scheme.initial)
        self.offer = None
        self.frame.begin(decides=session is not None)
        self.keys.begin(session or "")
