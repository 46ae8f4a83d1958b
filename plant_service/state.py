"""The plant's end as a state: the step under way, and machines that own a frozen record each."""

from plant_service.watchdog import Watchdog
from protocol.link.incoming import Incoming
from protocol.link.pacing import Pacing
from protocol.link.plant_session import PlantSession
from protocol.link.records import LinkRecord, Loaded, PlantRecord
from protocol.link.session import Rules
from protocol.link.state import EndState
from protocol.link.step import IDLE, Answered, Begun, Idle, Read
from protocol.secret.nonces import NonceSource


class PlantState(EndState):
    """All that the plant's end has of its loop.

    Parameters
    ----------
    rules, record, nonces, now
        As of :class:`protocol.link.state.EndState`.
    loaded : Loaded
        What the journal has besides.
    instance : str
        Random id of this process.
    pacing : Pacing
    watchdog : Watchdog

    Attributes
    ----------
    session : PlantSession
    applied : AppliedRecord
    frame : Incoming
    """

    step: Idle | Begun | Read

    def __init__(
        self,
        rules: Rules,
        record: PlantRecord,
        loaded: Loaded[PlantRecord],
        nonces: NonceSource,
        now: float,
        instance: str,
        pacing: Pacing,
        watchdog: Watchdog,
    ) -> None:
        super().__init__(rules, record, nonces, now)
        assert not isinstance(loaded.step, Answered)
        self.step = loaded.step
        self.session = PlantSession(instance, rules.fingerprint, record, now)
        self.applied = record.applied
        self.frame = Incoming(rules.size, record.frame, loaded.symbols)
        self.keys.resume(record.session.id, record.keys, loaded.rows, loaded.held)
        self.pacing, self.watchdog = pacing, watchdog

    @property
    def record(self) -> PlantRecord:
        """What the journal keeps of it beside the step."""
        session, frame, keys = self.session.record, self.frame.record, self.keys.record
        return PlantRecord(session, self.link, self.applied, frame, keys)

    @property
    def moved(self) -> bool:
        """Whether the plant was ever moved, or a step of its was missed."""
        return self.link.k > 0 or self.step is not IDLE

    @property
    def running(self) -> bool:
        """Whether ticks count: only once the plant has moved or a controller has accepted it."""
        return self.moved or self.session.accepted

    def begin_session(self, session: str) -> None:
        """Begin a session: all that was agreed or half received in the one before is dropped."""
        link, state = self.link, self.rules.scheme.initial
        self.session.begin(session)
        self.link = LinkRecord(link.k, link.x, state=state, agreements=link.agreements)
        self.applied = self.applied._replace(x_after=(), copy=0, keyed=False)
        self.frame.reset()
        self.keys.begin(session)
