"""Both endpoints on the plant on a line, with a coin and a disturbance that a test chooses."""

from collections.abc import Callable, Iterable

from controller_service.core import ControllerCore
from plant_service.core import PlantCore
from plant_service.plant import Coin, Plant
from protocol.agreement import NO_SYMBOL
from protocol.link.events import Event
from protocol.link.pacing import Pacing
from protocol.link.peer import Notice, Write
from protocol.link.records import ReceiverRecord, Step
from protocol.link.session import Rules, Truth
from protocol.messages import Measurement, Message, Status
from protocol.secret.nonces import NonceSource, fresh_nonce
from protocol.secret.records import Key
from protocol.secret.tasks import Task
from protocol.streams import SymbolSource
from protocol.vectors import Vector
from runtime.memory_journal import MemoryControllerJournal, MemoryPlantJournal
from tests.support.mail import Mail, mail

PERIOD_S = 1.0


class LinePlant(Coin):
    """x+ = x + u + d; on a missed step u is held. ``coin`` and ``d`` are the next step's."""

    acts = device = False
    truth: Truth | None = None

    def __init__(self) -> None:
        self.coin = 0
        self.d = 0.0
        self._x = self._u = 0.0

    def prepare(self, j: int) -> None:
        pass

    def toss(self, j: int) -> int:
        return self.coin

    def begin(self, k: int, x: Vector, u: Vector) -> None:
        self._x, self._u = x[0], u[0]

    def end(self, k: int) -> Vector:
        return (self._x + self._u + self.d,)

    def safe(self, why: str) -> None:
        pass

    def close(self) -> str:
        return ""


def hold(x: Vector, in_force: Vector) -> Vector:
    """The fallback of the plant on a line."""
    return in_force


class Reports:
    """What a plant saved that it would say, beside the record that comes of it."""

    def __init__(self) -> None:
        self._said: Measurement | None = None

    def look(self, write: Write) -> None:
        """A step's record says what its report said, before the report may be said again."""
        if isinstance(write, Step):
            self._said = write.measurement if write.coin != NO_SYMBOL else None
            return
        report, record, self._said = self._said, write.record, None
        if report is None or not isinstance(record, ReceiverRecord) or record.k != report.k:
            return
        if record.session == report.session:
            assert (record.x, record.x_after, record.applied_k) == (
                report.x,
                report.x_after,
                report.applied_k,
            )
            assert (record.nonce, record.applied_copy) == (report.nonce, report.applied_copy)
            assert (record.block, record.tag) == (report.block, report.tag)
            assert (report.applied_key or "") == (record.coin_key if record.keyed else "")


class ToldPorts:
    """Ports that keep what is written and hand everything else to whoever asked for it."""

    def __init__(
        self,
        journal: MemoryControllerJournal | MemoryPlantJournal,
        publish: Callable[[Mail], None],
        trace: Callable[[Event], None],
        log_notice: Callable[[Notice], None] = lambda _: None,
    ) -> None:
        self.journal = journal
        self._reports = Reports()
        self._publish = publish
        self._trace = trace
        self._tell = log_notice

    def write(self, write: Write) -> None:
        self._reports.look(write)
        self.journal.write(write)

    def publish(self, message: Message) -> None:
        self._publish(mail(message))

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
    coin_keys: Iterable[Key] = (),
) -> ControllerCore:
    """A controller's endpoint as its journal has it."""
    record, step = journal.load(), journal.step()
    contributions = journal.contributions(None if record is None else record.session)
    return ControllerCore(
        rules,
        propose,
        journal,
        fresh,
        instance=instance,
        period_s=period_s,
        record=record,
        step=step,
        contributions=contributions,
        coin_keys=coin_keys,
        nonces=nonces,
    )


def line_plant(
    rules: Rules,
    journal: MemoryPlantJournal,
    new_id: Callable[[], str],
    instance: str,
    now: float,
    step_s: float | None,
    nonces: NonceSource = fresh_nonce,
    repeats: int = 4,
    coin_keys: Iterable[Key] = (),
    steps: int | None = None,
) -> tuple[PlantCore, LinePlant]:
    """A plant's endpoint as its journal has it, and what it steps; it begins at 0."""
    plant = LinePlant()
    core = line_core(
        rules,
        plant,
        journal,
        new_id,
        instance,
        now,
        step_s,
        nonces,
        repeats,
        coin_keys=coin_keys,
        steps=steps,
    )
    return core, plant


def line_core(
    rules: Rules,
    plant: Plant,
    journal: MemoryPlantJournal,
    new_id: Callable[[], str],
    instance: str,
    now: float,
    step_s: float | None,
    nonces: NonceSource,
    repeats: int,
    x: Vector | None = None,
    coin_keys: Iterable[Key] = (),
    steps: int | None = None,
) -> PlantCore:
    """The core of what tosses its own coin; ``x`` is what it reads first, if it acts."""
    assert isinstance(plant, Coin)
    record = journal.load()
    first = record or ReceiverRecord(session=new_id(), k=0, x=x or (0.0,), u=(0.0,))
    return PlantCore(
        rules,
        plant,
        plant,
        hold,
        Pacing(step_s, repeats, now),
        new_id,
        now,
        instance=instance,
        record=first,
        chunks=journal.chunks(),
        contributions=journal.contributions(first.session),
        coin_keys=coin_keys,
        step=journal.step(),
        back=None if record is None else x,
        fresh=record is None,
        steps=steps,
        nonces=nonces,
    )
