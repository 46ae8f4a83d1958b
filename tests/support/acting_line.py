"""The plant on a line as a device: actuated, read, and there when the process is not."""

from collections.abc import Callable, Iterable

from plant_service.adapters.operated import Operated
from plant_service.core import PlantCore
from plant_service.plant import Coin, OperatedPlant
from protocol.link.events import Event, Interrupted, Missed
from protocol.link.session import CountedTransition, Rules
from protocol.secret.nonces import NonceSource, fresh_nonce
from protocol.secret.records import Key
from protocol.vectors import Vector
from runtime.memory_journal import MemoryPlantJournal
from runtime.perform import CrashPoint
from tests.support.line_ends import line_core


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


def acting_plant(
    rules: Rules,
    journal: MemoryPlantJournal,
    device: LineDevice,
    new_id: Callable[[], str],
    instance: str,
    now: float,
    step_s: float | None,
    nonces: NonceSource = fresh_nonce,
    repeats: int = 4,
    coin_keys: Iterable[Key] = (),
) -> tuple[PlantCore, ActingLine]:
    """A plant's endpoint as its journal has it, and what it acts on."""
    x = device.start()
    plant = ActingLine(device)
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
        x,
        coin_keys=coin_keys,
    )
    return core, plant
