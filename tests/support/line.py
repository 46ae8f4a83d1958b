"""The smallest plant that has the whole link, x+ = x + u + d with D_c = [-1, 1], and its endpoints.

It is a model, or a device: actuated, read, and there when the process is not. A test chooses coin
and disturbance.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

from controller_service.core import ControllerCore
from plant_service.adapters.operated import Operated
from plant_service.core import PlantCore
from plant_service.plant import Coin, OperatedPlant
from protocol.agreement import AgreementRule, Gauge
from protocol.link.effects import Save
from protocol.link.events import Event, Interrupted, Missed
from protocol.link.pacing import Pacing
from protocol.link.records import PlantRecord
from protocol.link.session import CountedTransition, Rules, Truth
from protocol.link.step import Read
from protocol.messages import ControllerHello, Measurement
from protocol.schemes.base import Scheme
from protocol.schemes.switched import Switched
from protocol.secret.blocks import Schedule
from protocol.secret.bound import Assumption
from protocol.secret.nonces import NonceSource
from protocol.streams import SymbolSource
from protocol.vectors import Vector
from runtime.chance import fresh_nonce
from runtime.journal import ControllerJournal, PlantJournal
from runtime.perform import CrashPoint
from tests.support.records import plant_record

PERIOD_S = 1.0

SMALL_BLOCKS: Final = Schedule(Assumption(0.95, eps_sec=1e-2), first=3, largest=6)
"""Blocks of three transitions and then six, so that keys come all the time."""


def line_rules(
    alpha: float,
    largest_input: float,
    fingerprint: str = "f" * 64,
    scheme: Scheme[Any] | None = None,
) -> Rules:
    """What both ends share of it; the paper's scheme for two candidates if none is given."""
    gauge = Gauge(half_widths=(1.0,))
    return Rules(
        agreement=AgreementRule(A=((1.0,),), B=((1.0,),), gauge=gauge, alpha=alpha),
        scheme=Switched(2) if scheme is None else scheme,
        states=1,
        inputs=1,
        fingerprint=fingerprint,
        inputs_gauge=Gauge(half_widths=(largest_input,)),
    )


def keyed_rules(**more: Any) -> Rules:
    """The rules of the line with :data:`SMALL_BLOCKS`, and what else is given."""
    return replace(line_rules(alpha=4.0, largest_input=1e9), **{"schedule": SMALL_BLOCKS, **more})


def disowned(plant: PlantCore) -> ControllerHello:
    """What a controller says that was misled, or holds other keys: the session is over."""
    return ControllerHello(
        instance=plant.state.session.controller or "",
        incarnation=plant.state.record.session.incarnation,
        fingerprint=plant.state.rules.fingerprint,
        verdict="unknown-session",
        session=plant.state.record.session.id,
        answers=plant.instance,
    )


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

    def look(self, save: Save) -> None:
        """A step's record says what its report said, before the report may be said again."""
        record = save.record
        report, self._said = self._said, None
        if isinstance(save.step, Read):
            self._said = save.step.report
        if report is None or not isinstance(record, PlantRecord) or record.link.k != report.k:
            return
        if record.session.id == report.session:
            assert (record.link.x, record.applied.x_after, record.link.applied_k) == (
                report.x,
                report.x_after,
                report.applied_k,
            )
            assert (record.link.nonce, record.applied.copy) == (report.nonce, report.applied_copy)
            newest = report if self._said is None else self._said
            assert (record.keys.block, record.keys.tag) == (newest.block, newest.tag)
            assert bool(report.keyed) == record.applied.keyed


def line_controller(
    rules: Rules,
    propose: Callable[[Vector], tuple[Vector, ...]],
    journal: ControllerJournal,
    fresh: SymbolSource,
    instance: str,
    nonces: NonceSource = fresh_nonce,
    period_s: float = PERIOD_S,
) -> ControllerCore:
    """A controller's endpoint as its journal has it."""
    return ControllerCore(
        rules,
        propose,
        journal,
        fresh,
        instance=instance,
        period_s=period_s,
        loaded=journal.load(),
        nonces=nonces,
    )


class LineDevice(Operated):
    """x+ = x + u + d, with ``u`` as it was actuated last; nothing of it dies with a process.

    Who looks after deaths sets ``passes``, which is asked before it is actuated or read.
    """

    passes: Callable[[CrashPoint], None]

    def __init__(self) -> None:
        self.x = 0.0
        self.u: float | None = None  # unknown until it was actuated
        self.d = 0.0
        self.over: float | None = None  # the input of the step that was read last
        self.connected = 0

    @property
    def device(self) -> bool:
        return True

    def start(self, seed: int | None = None) -> Vector:
        """Connect: a step has gone by meanwhile."""
        self.connected += 1
        return self._moved()

    def apply(self, u: Vector, d: Vector | None = None) -> Vector:
        self.passes("acting")
        (self.u,) = u
        return u

    def sample(self, d: Vector | None = None) -> Vector:
        self.passes("acting")
        return self._moved()

    def _moved(self) -> Vector:
        self.over = self.u
        self.x += (self.u or 0.0) + self.d
        return (self.x,)

    def safe(self, why: str = "") -> None:
        raise AssertionError(why)

    def close(self) -> str:
        raise AssertionError("nobody closes it")

    def look(self, event: Event, *, alive: bool) -> None:
        """A step that is traced was made by the device as the trace says.

        ``alive``: by this process, which knows what it had applied.
        """
        if not isinstance(event, CountedTransition | Missed | Interrupted):
            return
        if alive and self.over is not None:
            assert event.x_next == (self.x,), "a step led elsewhere than its trace says"
            assert event.u == (self.over,), "a step had another input than its trace says"


class ActingLine(OperatedPlant, Coin):
    """The real order of a step, on the line; ``coin`` and ``d`` are the next step's."""

    def __init__(self, device: LineDevice) -> None:
        self.operated = device
        self.acts = self.device = True
        self.coin = 0
        self._enters = "none"

    @property
    def d(self) -> float:
        assert isinstance(self.operated, LineDevice)
        return self.operated.d

    @d.setter
    def d(self, d: float) -> None:
        assert isinstance(self.operated, LineDevice)
        self.operated.d = d

    def prepare(self, k: int) -> None:
        pass

    def toss(self, j: int) -> int:
        return self.coin


def line_plant(
    rules: Rules,
    journal: PlantJournal,
    new_id: Callable[[], str],
    instance: str,
    now: float,
    step_s: float | None,
    nonces: NonceSource = fresh_nonce,
    repeats: int = 4,
    device: LineDevice | None = None,
) -> tuple[PlantCore, LinePlant | ActingLine]:
    """A plant's endpoint as its journal has it, and what it steps, or acts on; it begins at 0."""
    x = None if device is None else device.start()
    plant = LinePlant() if device is None else ActingLine(device)
    loaded = journal.load()
    first = None
    if loaded.record is None:
        first = plant_record(session=new_id(), k=0, x=x or (0.0,), u=(0.0,))
    core = PlantCore(
        rules,
        plant,
        plant,
        hold,
        Pacing(step_s, repeats, now),
        new_id,
        now,
        instance=instance,
        loaded=loaded,
        first=first,
        back=None if first is not None else x,
        nonces=nonces,
    )
    return core, plant
