"""``[plant]``: what is simulated or driven, and what disturbs it."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field, FiniteFloat, field_validator

from protocol.knowledge import NotNegative
from protocol.scenario.noise import SensorNoise
from protocol.scenario.parts import Positive, ScenarioTable, check_matrix, shape, shape_problem
from protocol.vectors import FiniteMatrix, FiniteVector


class Disturbance(ScenarioTable):
    """What the simulated plant really suffers: d(k), drawn from ``n`` uniform numbers a step.

    ``uniform`` draws from the box D; ``corners`` from its corners; ``truncated-gaussian`` and
    ``gaussian`` have standard deviation ``deviation`` times the half-width (the second leaves D);
    ``constant`` is the corner ``bias`` times the half-width; ``sinusoid`` has the half-width as its
    amplitude and ``cycle_steps`` steps to a cycle.

    It is added to the state, to the ``input`` (then of ``m`` half-widths) or not at all: a plant
    that is not ours to write to has a disturbance of its own.
    """

    kind: Literal[
        "uniform", "corners", "truncated-gaussian", "gaussian", "constant", "sinusoid"
    ] = "uniform"
    """How d(k) is drawn."""
    half_widths: tuple[NotNegative, ...] = ()
    """Half-widths of the box D, a state (or, where it enters there, an input) each."""
    enters: Literal["state", "input", "none"] | None = None
    """Where d is added: to the state (where not given), to the input, or nowhere."""
    deviation: Positive = 0.5
    """Standard deviation of the two Gaussian kinds, in half-widths."""
    bias: Annotated[float, Field(ge=-1, le=1)] = 1.0
    """Of kind constant: which share of the half-width d always is."""
    cycle_steps: Annotated[int, Field(ge=2)] = 20
    """Of kind sinusoid: steps to a cycle."""
    may_leave_defender_set: bool = False
    """Allow D to leave D_c; keys may then differ between the two ends."""


class OperatingPointTable(ScenarioTable):
    """Where deviations are counted from and in which unit: x = (y - state) / state_scale."""

    state: FiniteVector | None = None
    """Reading at which x = 0; zero where not given."""
    input: FiniteVector
    """What is applied where u = 0, in the plant's units."""
    state_scale: tuple[Positive, ...] | None = None
    """Reading units to one of x, a state each; 1 where not given."""
    input_scale: tuple[Positive, ...] | None = None
    """The plant's units to one of u, an input each; 1 where not given."""

    def problems(self, n: int, m: int) -> Iterator[str]:
        """What does not fit a plant that gives ``n`` numbers and takes ``m``, a line each."""
        for name, size in (("state", n), ("input", m), ("state_scale", n), ("input_scale", m)):
            values = getattr(self, name)
            if values is not None:
                yield from shape_problem(f"plant.operating_point.{name}", len(values), size)

    @property
    def given(self) -> int:
        """Numbers that the plant is said to give; 0 where it is not said."""
        return len(self.state or self.state_scale or ())


class PlantTable(ScenarioTable):
    """The plant that is simulated or driven, every ``period_s`` seconds; the common fields.

    A kind has fields of its own and reads a subclass, :data:`protocol.scenario.kinds.PLANTS`.
    States, inputs and disturbances are deviations from the operating point, ``limits`` physical
    readings.

    Parameters
    ----------
    A, B : tuple of tuple of float, shapes (n, n) and (n, m), optional
        Of a plant of kind ``linear``, x+ = A x + B u + d.
    C : tuple of tuple of float, shape (r, n), optional
        What is read of it, y = C x + n; the whole state where not given.
    initial_state : tuple of float, shape (n,)
        Empty where the plant starts as it stands.
    limits : tuple of (low, high), optional
        Of each reading; one outside sends the plant to its safe state.
    """

    kind: str = "linear"
    """What is simulated or driven."""
    A: FiniteMatrix | None = None
    """State matrix, n rows of n numbers."""
    B: FiniteMatrix | None = None
    """Input matrix, n rows of m numbers."""
    C: FiniteMatrix | None = None
    """What the sensors read, r rows of n numbers: y = C x + n; the state itself where not given."""
    period_s: Positive
    """Seconds from one step to the next."""
    initial_state: FiniteVector = ()
    """x(0); empty where the plant starts as it stands."""
    disturbance: Disturbance
    """What disturbs the plant."""
    noise: SensorNoise | None = None
    """What its sensors add: a reading is y = x + n. A device's sensors have their own."""
    operating_point: OperatingPointTable | None = None
    """Where deviations are counted from, and in which unit."""
    limits: tuple[tuple[FiniteFloat, FiniteFloat], ...] | None = None
    """Low and high of each reading; outside, the plant goes to its safe state."""

    @field_validator("A", "B", "C")
    @classmethod
    def _matrices(cls, matrix: FiniteMatrix | None) -> FiniteMatrix | None:
        return None if matrix is None else check_matrix(matrix)

    def problems(self, n: int, m: int) -> Iterator[str]:
        """What does not fit ``n`` states and ``m`` inputs, a line each."""
        if self.A is not None:
            yield from shape_problem("plant.A", shape(self.A), (n, n))
        if self.B is not None:
            yield from shape_problem("plant.B", shape(self.B), (n, m))
        if self.initial_state or self.A is not None:
            yield from shape_problem("plant.initial_state", len(self.initial_state), n)
        d = self.disturbance
        size = {"input": m, "none": 0}.get(d.enters or "state", n)
        yield from shape_problem("plant.disturbance.half_widths", len(d.half_widths), size)
        readings = n
        if self.C is not None:
            readings = len(self.C)
            yield from shape_problem("plant.C", shape(self.C), (readings, n))
        if self.noise is not None:
            yield from shape_problem("plant.noise", self.noise.dimension, readings)
        # a simulation gives its states, a device what its sensors read
        point, limits = self.operating_point, self.limits
        told = {point.given if point is not None else 0, len(limits or ())}
        own = readings if readings in told else n
        if point is not None:
            yield from point.problems(own, m)
        if limits is not None:
            yield from shape_problem("plant.limits", len(limits), own)
