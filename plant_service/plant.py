"""What the plant's core moves: one interface, a step of which is begun and ended.

A computed model, a simulation and a device differ in two facts: whether a step acts, and whether
the plant moves by itself. The order of a step is the core's (:mod:`plant_service.core`).
"""

from collections.abc import Sequence
from math import isfinite
from operator import add
from typing import Protocol

from plant_service.adapters.operated import Operated
from plant_service.disturbance import disturbance
from protocol.agreement import predict
from protocol.link.filters import Filter, read_through, sensors_of
from protocol.link.records import PlantRecord
from protocol.link.session import TrueStep
from protocol.messages import FIELD, Measurement
from protocol.scenario import Scenario
from protocol.streams import Stream
from protocol.topics import key_of
from protocol.vectors import Vector
from runtime.bus import Bus, Overheard
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
    truth : TrueStep or None
        What the step that ended last really came to, where the plant is attacked.
    """

    acts: bool
    device: bool
    truth: TrueStep | None

    def begin(self, k: int, x: Vector, u: Vector) -> None:
        """Apply ``u`` at x(k)."""

    def end(self, k: int) -> Vector:
        """x(k+1), at the end of step ``k``."""

    def safe(self, why: str) -> None:
        """Go to the safe state."""

    def close(self) -> str:
        """Close the plant. Returns in one line what its code raised, or nothing."""


class Disturbances:
    """The simulated disturbance d(k), drawn once a step.

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
    truth: TrueStep | None = None

    def __init__(self, scenario: Scenario, disturbances: Disturbances) -> None:
        self._A, self._B = scenario.plant_model
        self._disturbances = disturbances
        self._x: Vector = ()
        self._u: Vector = ()

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

    truth: TrueStep | None = None

    def __init__(self, operated: Operated, disturbances: Disturbances, enters: str) -> None:
        self.operated = operated
        self.device = operated.device
        self.acts = operated.device or not operated.resumable
        self._disturbances = disturbances
        self._enters = enters

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


class FilteredPlant:
    """A plant behind filters: its state stands here, and the core gets what is read through them.

    Parameters
    ----------
    plant : Plant
    filters : sequence of Filter
        In the order of a reading's way to the core.
    x : tuple of float, shape (n,)
        Where the plant stands.
    told : bool
        Whether the truth of a step is told.
    """

    def __init__(
        self, plant: Plant, filters: Sequence[Filter], x: Vector, *, told: bool = True
    ) -> None:
        self._plant = plant
        self.filters = filters
        self.acts = plant.acts or any(one.acts for one in filters)
        self.x = x
        self._told = told
        self.device = plant.device
        self.truth: TrueStep | None = None
        self._u: Vector = ()

    def recall(self, k: int, y: Vector, u: Vector) -> None:
        """Step ``k - 1``, of the journal, led to the reading ``y`` under ``u``."""
        for one in self.filters:
            self.x = one.known(k, self.x, y)
        self.truth = TrueStep(self.x, u)

    def begin(self, k: int, x: Vector, u: Vector) -> None:  # noqa: ARG002
        """Apply what the filters make of ``u``, where the plant stands; ``x`` is its reading."""
        for one in self.filters:
            u = one.actuator(k, u)
        self._u = u
        self._plant.begin(k, self.x, u)

    def end(self, k: int) -> Vector:
        """x(k+1) as it is read; the true one is in :attr:`truth`."""
        self.x = self._plant.end(k)
        y, self.x = read_through(self.filters, k + 1, self.x)
        if self._told:
            fault = "".join(one.fault() for one in self.filters)
            self.truth = TrueStep(self.x, self._u, fault)
        return y

    def safe(self, why: str) -> None:
        """As the plant."""
        self._plant.safe(why)

    def close(self) -> str:
        """As the plant."""
        for one in self.filters:
            one.close()
        return self._plant.close()

    def overheard(self, bus: Bus, loop: str) -> Bus:
        """The field bus, of which the filters that listen hear every message that passes here."""
        listening = [one for one in self.filters if one.listens]
        if not listening:
            return bus
        kinds = {key_of(kind, loop): kind for kind in FIELD}

        def incoming(key: str, payload: bytes) -> None:
            for one in listening:
                one.incoming(kinds[key], payload)

        def outgoing(key: str, payload: bytes) -> None:
            for one in listening:
                one.outgoing(kinds[key], payload)

        return Overheard(bus, outgoing, incoming)


def sensed(
    plant: Plant,
    scenario: Scenario,
    attack: Filter | None,
    draws: Stream,
    started: Vector | None,
    record: PlantRecord | None,
    last: tuple[Measurement, Vector] | None,
) -> tuple[Plant, Vector | None]:
    """The plant behind its filters, and its first reading.

    Parameters
    ----------
    plant : Plant
    scenario : Scenario
    attack : Filter, optional
        The last of them.
    draws : Stream
        Of the sensors' noise.
    started : tuple of float, optional
        Where the plant has started; None: where the scenario says.
    record : PlantRecord, optional
        As read back from a journal.
    last : tuple of Measurement and tuple of float, optional
        What the journal's uncounted step came to, and the input that led there.
    """
    sensors = [] if plant.device else sensors_of(scenario, draws)
    if attack is None and not sensors:
        return plant, started
    outputs = scenario.observer is not None
    filters = sensors if attack is None else [*sensors, attack]
    x = scenario.initial_state if started is None else started
    found = FilteredPlant(plant, filters, x, told=not (outputs and plant.acts))
    if last is not None and attack is None and not outputs:
        report, u = last
        found.recall(report.k, report.x, u)
    if record is None or found.acts:  # it stands where it has started
        y, found.x = read_through(sensors, 0 if record is None else record.link.k + 1, x)
        return found, y
    if outputs:
        found.x = record.applied.true_x or x
        if last is not None:  # the step is made again
            report, u = last
            found.begin(report.applied_k, (), u)
            found.end(report.applied_k)
    elif last is None:
        found.recall(record.link.k, record.link.x, ())
        found.truth = None
    return found, None
