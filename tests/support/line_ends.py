"""Both endpoints on the plant on a line, with a coin and a disturbance that a test chooses."""

from collections.abc import Callable

from controller_service.peer import ControllerPeer
from plant_service.peer import PlantPeer
from plant_service.plant import Move, PlantStep
from protocol.link.events import Event
from protocol.link.pacing import Pacing
from protocol.link.peer import Notice, Outgoing, Write
from protocol.link.receiver import Receiver
from protocol.link.records import ReceiverRecord
from protocol.link.sender import Sender
from protocol.link.session import Rules
from protocol.messages import Message, Offer, Status
from protocol.secret.nonces import NonceSource, fresh_nonce
from protocol.secret.tasks import Task
from protocol.streams import SymbolSource
from protocol.vectors import Vector
from runtime.memory_journal import MemoryControllerJournal, MemoryPlantJournal

PERIOD_S = 1.0


class LinePlant:
    """x+ = x + u + d; on a missed step u is held. ``coin`` and ``d`` are the next step's."""

    def __init__(self, receiver: Receiver) -> None:
        self.receiver = receiver
        self.coin = 0
        self.d = 0.0

    def move(self, offer: Offer) -> Move:
        x, u = self.receiver.record.x[0], offer.candidates[self.coin][0]
        return Move(offer, self.coin, (x + u + self.d,))

    def count(self, move: Move) -> PlantStep:
        record, reported = self.receiver.record, self.receiver.moved(move.offer, move.x_next)
        effects = self.receiver.applied(move.offer, move.coin, move.x_next)
        assert self.receiver.record.nonce == reported.nonce
        assert self.receiver.keying.on or self.receiver.measurement() == reported
        u = move.offer.candidates[move.coin]
        return PlantStep(record.k, record.x, u, move.x_next, move.coin, effects)

    def miss(self) -> PlantStep:
        record = self.receiver.record
        x_next = (record.x[0] + record.u[0] + self.d,)
        self.receiver.missed(record.u, x_next)
        return PlantStep(record.k, record.x, record.u, x_next, None, None)

    def safe(self, why: str) -> None:
        pass

    def close(self) -> str:
        return ""


class ToldPorts:
    """Ports that keep what is written and hand everything else to whoever asked for it."""

    def __init__(
        self,
        journal: MemoryControllerJournal | MemoryPlantJournal,
        publish: Callable[[Outgoing], None],
        trace: Callable[[Event], None],
        log_notice: Callable[[Notice], None] = lambda _: None,
    ) -> None:
        self.journal = journal
        self._publish = publish
        self._trace = trace
        self._tell = log_notice

    def write(self, write: Write) -> None:
        self.journal.write(write)

    def publish(self, kind: type[Message], payload: bytes) -> None:
        self._publish(Outgoing(kind, payload))

    def submit_key_task(self, task: Task) -> None:
        raise AssertionError("keys are made, and nobody keeps them")

    def trace(self, event: Event) -> None:
        self._trace(event)

    def log_notice(self, notice: Notice) -> None:
        self._tell(notice)

    def health(self, status: Status) -> None:
        raise AssertionError("nobody asked for statuses")


def line_controller(
    rules: Rules,
    propose: Callable[[Vector], tuple[Vector, ...]],
    journal: MemoryControllerJournal,
    fresh: SymbolSource,
    instance: str,
    nonces: NonceSource = fresh_nonce,
    period_s: float = PERIOD_S,
) -> ControllerPeer:
    """A controller's endpoint as its journal has it."""
    record, step = journal.load(), journal.step()
    contributions = journal.contributions(None if record is None else record.session)
    sender = Sender(rules, propose, journal, fresh, instance, record, step, contributions, nonces)
    return ControllerPeer(sender, journal, period_s)


def line_plant(
    rules: Rules,
    journal: MemoryPlantJournal,
    new_id: Callable[[], str],
    instance: str,
    now: float,
    step_s: float | None,
    nonces: NonceSource = fresh_nonce,
    repeats: int = 4,
) -> tuple[PlantPeer, LinePlant]:
    """A plant's endpoint as its journal has it, and what it steps; it begins at 0."""
    record, step = journal.load(), journal.step()
    first = record or ReceiverRecord(session=new_id(), k=0, x=(0.0,), u=(0.0,))
    said = None if step is None else step.measurement
    contributions = journal.contributions(first.session)
    receiver = Receiver(rules, instance, first, journal.chunks(), contributions, said, nonces)
    plant = LinePlant(receiver)
    endpoint = PlantPeer(
        plant,
        Pacing(step_s, repeats, now),
        new_id,
        now,
        pending=None if step is None else Move(step.offer, step.coin, step.measurement.x),
        fresh=record is None,
    )
    return endpoint, plant
