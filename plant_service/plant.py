"""What the plant's core moves: one interface, a step of which is begun and ended.

A computed model, a simulation and a device differ in two facts: whether a step acts, and whether
the plant moves by itself. The order of a step is the core's (:mod:`plant_service.core`).
"""

from math import isfinite
from operator import add, sub
from typing import Protocol

from plant_service.adapters.operated import Operated
from plant_service.disturbance import disturbance
from protocol.agreement import predict
from protocol.box_observer import BoxObserver
from protocol.link.session import Truth
from protocol.scenario import Scenario, SensorNoise
from protocol.streams import Stream, SymbolSource
from protocol.vectors import Vector
from runtime.errors import Failure


class Plant(Protocol):
    """What is stepped.

    Attributes
    ----------
    acts : bool
        A step cannot be made twice, so its coin is saved before it begins. A step that does not
        act begins and ends at once, and a process that died computes it again.
    device : bool
        The plant moves by itself. A step without an offer goes on under the input in force, and
        the fallback is applied for the step after it.
    truth : Truth or None
        What the step that ended last really came to, where the plant is attacked.
    """

    acts: bool
    device: bool
    truth: Truth | None

    def prepare(self, k: int) -> None:
        """Draw ahead what step ``k``, the next one, needs; nobody waits for it now."""

    def begin(self, k: int, x: Vector, u: Vector) -> None:
        """Apply ``u`` at x(k)."""

    def end(self, k: int) -> Vector:
        """x(k+1), at the end of step ``k``."""

    def safe(self, why: str) -> None:
        """Go to the safe state."""

    def close(self) -> str:
        """Close the plant. Returns in one line what its code raised, or nothing."""


class Coin:
    """b_r, the plant's choice of a candidate, drawn ahead where there is time.

    Parameters
    ----------
    source : SymbolSource
        Draw j belongs to transition j.
    size : int
        M.
    """

    def __init__(self, source: SymbolSource, size: int) -> None:
        self._source = source
        self._size = size
        self._j = -1
        self._drawn = 0

    def prepare(self, j: int) -> None:
        """Draw ahead for transition ``j``, the next one; nobody waits for it now."""
        self._j, self._drawn = j, self._source.symbol(j, self._size)

    def toss(self, j: int) -> int:
        """b_r of transition ``j``."""
        return self._drawn if j == self._j else self._source.symbol(j, self._size)


class Disturbances:
    """The simulated disturbance d(k), drawn ahead where there is time.

    Parameters
    ----------
    scenario : Scenario
    noise : Stream
        Uniform numbers; draw k belongs to step k.
    """

    def __init__(self, scenario: Scenario, noise: Stream) -> None:
        self._spec = scenario.plant.disturbance
        self._noise = noise
        self._k = -1
        self._d: Vector = ()

    def at(self, k: int) -> Vector:
        """d(k); empty where the scenario has none."""
        if k != self._k:
            spec = self._spec
            self._d = disturbance(spec, k, self._noise.at(k)) if spec.half_widths else ()
            self._k = k
        return self._d


class LinearModel:
    """x+ = A x + B u + d, the sum of the prediction and the disturbance, by component.

    Parameters
    ----------
    scenario : Scenario
    disturbances : Disturbances
    """

    acts = device = False
    truth: Truth | None = None

    def __init__(self, scenario: Scenario, disturbances: Disturbances) -> None:
        self._A, self._B = scenario.plant_model
        self._disturbances = disturbances
        self._x: Vector = ()
        self._u: Vector = ()

    def prepare(self, k: int) -> None:
        """Draw d(k)."""
        self._disturbances.at(k)

    def begin(self, k: int, x: Vector, u: Vector) -> None:  # noqa: ARG002
        """Stand at ``x``, with ``u`` applied."""
        self._x, self._u = x, u

    def end(self, k: int) -> Vector:
        """x(k+1).

        Raises
        ------
        Failure
            When it is no longer finite.
        """
        d = self._disturbances.at(k)
        x_next = tuple(map(add, predict(self._A, self._B, self._x, self._u), d))
        if not all(map(isfinite, x_next)):
            raise Failure(f"the state is no longer finite at step {k + 1}")
        return x_next

    def safe(self, why: str) -> None:
        """Nothing: a model has nothing to stop."""

    def close(self) -> str:
        """Nothing is open, and nothing fails."""
        return ""


class NoisyPlant:
    """A plant that is read through sensors with noise: y(k) = x(k) + n(k).

    What is known of it outside is y. Its state is y(k) - n(k), and n(k) is draw k of a seeded
    stream: so it stands in no journal, and is the same after a restart.

    Parameters
    ----------
    plant : Plant
    noise : SensorNoise
    draws : Stream
        Of as many uniform numbers as there are states.
    """

    def __init__(self, plant: Plant, noise: SensorNoise, draws: Stream) -> None:
        self._plant = plant
        self._noise, self._draws = noise, draws
        self.acts, self.device = plant.acts, plant.device
        self.truth: Truth | None = None
        self._u: Vector = ()

    def read(self, k: int, x: Vector) -> Vector:
        """y(k)."""
        return tuple(map(add, x, self._noise.drawn(self._draws.at(k))))

    def state(self, k: int, y: Vector) -> Vector:
        """x(k)."""
        return tuple(map(sub, y, self._noise.drawn(self._draws.at(k))))

    def recall(self, k: int, y: Vector, u: Vector) -> None:
        """Step ``k - 1``, of the journal, led to ``y`` under ``u``."""
        self.truth = Truth(self.state(k, y), u)

    def prepare(self, k: int) -> None:
        """As the plant."""
        self._plant.prepare(k)

    def begin(self, k: int, x: Vector, u: Vector) -> None:
        """Apply ``u`` at the state that was read as ``x``."""
        self._u = u
        self._plant.begin(k, self.state(k, x), u)

    def end(self, k: int) -> Vector:
        """y(k+1)."""
        y = self.read(k + 1, self._plant.end(k))
        self.truth = Truth(self.state(k + 1, y), self._u)
        return y

    def safe(self, why: str) -> None:
        """As the plant."""
        self._plant.safe(why)

    def close(self) -> str:
        """As the plant."""
        return self._plant.close()


class OutputPlant:
    """A simulation that is read through some outputs alone: y(k) = C x(k) + n(k).

    Its state stands in the plant's journal, as no reading tells it. A step that the journal has and
    did not count is made again, where it does not act: so n and d must come of streams that are the
    same after a restart. Of one that acts the state is lost with the process, and is never told.

    Parameters
    ----------
    plant : Plant
        No device, whose sensors read what they read.
    observer : BoxObserver
        For C.
    noise : SensorNoise, optional
        None: the sensors are exact.
    draws : Stream
        Of as many uniform numbers as there are readings.
    x : tuple of float, shape (n,)
        Where the plant stands.
    """

    device = False

    def __init__(
        self,
        plant: Plant,
        observer: BoxObserver,
        noise: SensorNoise | None,
        draws: Stream,
        x: Vector,
    ) -> None:
        self._plant, self._observer = plant, observer
        self._noise, self._draws = noise, draws
        self._x = x
        self._u: Vector = ()
        self.acts = plant.acts
        self.truth: Truth | None = None

    def read(self, k: int) -> Vector:
        """y(k), of the state as it is."""
        exact = self._observer.read(self._x)
        if self._noise is None:
            return exact
        return tuple(map(add, exact, self._noise.drawn(self._draws.at(k))))

    def prepare(self, k: int) -> None:
        """As the plant."""
        self._plant.prepare(k)

    def begin(self, k: int, x: Vector, u: Vector) -> None:  # noqa: ARG002
        """Apply ``u`` where the plant stands; ``x`` is what was read of that."""
        self._u = u
        self._plant.begin(k, self._x, u)

    def end(self, k: int) -> Vector:
        """y(k+1)."""
        self._x = self._plant.end(k)
        self.truth = None if self.acts else Truth(self._x, self._u)
        return self.read(k + 1)

    def safe(self, why: str) -> None:
        """As the plant."""
        self._plant.safe(why)

    def close(self) -> str:
        """As the plant."""
        return self._plant.close()


class OperatedPlant:
    """A device, or a simulation that somebody else wrote.

    A simulation whose reading is all its state is put where the step begins, and does not act.

    Parameters
    ----------
    operated : Operated
        Started already.
    disturbances : Disturbances
    enters : {"state", "input", "none"}
        Where the simulated disturbance reaches the plant.
    """

    truth: Truth | None = None

    def __init__(self, operated: Operated, disturbances: Disturbances, enters: str) -> None:
        self.operated = operated
        self.device = operated.device
        self.acts = operated.device or not operated.resumable
        self._disturbances = disturbances
        self._enters = enters

    def prepare(self, k: int) -> None:
        """Draw d(k)."""
        self._disturbances.at(k)

    def begin(self, k: int, x: Vector, u: Vector) -> None:
        """Apply ``u`` now.

        Raises
        ------
        PlantError
        """
        if not self.acts:
            self.operated.resume(x, k)
        self.operated.apply(u, self._disturbances.at(k) if self._enters == "input" else None)

    def end(self, k: int) -> Vector:
        """x(k+1), as it is read.

        Raises
        ------
        PlantError
        """
        return self.operated.sample(self._disturbances.at(k) if self._enters == "state" else None)

    def safe(self, why: str) -> None:
        """Send the plant to its safe state."""
        self.operated.safe(why)

    def close(self) -> str:
        """Close the plant. Returns in one line what its code raised, or nothing."""
        return self.operated.close()
