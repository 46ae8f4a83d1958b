"""``[plant]``: what is simulated or driven, and what disturbs it."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field, FiniteFloat, field_validator

from protocol.scenario.parts import (
    Matrix,
    NotNegative,
    Part,
    Positive,
    Vector,
    check_matrix,
    shape,
    shape_problem,
)


class Disturbance(Part):
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
    half_widths: tuple[NotNegative, ...] = ()
    enters: Literal["state", "input", "none"] | None = None
    deviation: Positive = 0.5
    bias: Annotated[float, Field(ge=-1, le=1)] = 1.0
    cycle_steps: Annotated[int, Field(ge=2)] = 20
    may_leave_defender_set: bool = False


class OperatingPoint(Part):
    """Where deviations are counted from and in which unit: x = (y - state) / state_scale.

    ``state`` may be left out where the plant settles at the operating input first.
    """

    state: Vector | None = None
    input: Vector
    state_scale: tuple[Positive, ...] | None = None
    input_scale: tuple[Positive, ...] | None = None

    def problems(self, n: int, m: int) -> Iterator[str]:
        """What does not fit ``n`` states and ``m`` inputs, a line each."""
        for name, size in (("state", n), ("input", m), ("state_scale", n), ("input_scale", m)):
            values = getattr(self, name)
            if values is not None:
                yield from shape_problem(f"plant.operating_point.{name}", len(values), size)


class Plant(Part):
    """The plant that is simulated or driven, every ``period_s`` seconds; the common fields.

    A kind has fields of its own and reads a subclass, :data:`protocol.scenario.kinds.PLANTS`.
    States, inputs and disturbances are deviations from the operating point, ``limits`` physical
    readings.

    Parameters
    ----------
    A, B : tuple of tuple of float, shapes (n, n) and (n, m), optional
        Of a plant of kind ``linear``, x+ = A x + B u + d.
    initial_state : tuple of float, shape (n,)
        Empty where the plant starts as it stands.
    limits : tuple of (low, high), optional
        Of each reading; one outside sends the plant to its safe state.
    """

    kind: str = "linear"
    A: Matrix | None = None
    B: Matrix | None = None
    period_s: Positive
    initial_state: Vector = ()
    disturbance: Disturbance
    operating_point: OperatingPoint | None = None
    limits: tuple[tuple[FiniteFloat, FiniteFloat], ...] | None = None

    @field_validator("A", "B")
    @classmethod
    def _matrices(cls, matrix: Matrix | None) -> Matrix | None:
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
        if self.operating_point is not None:
            yield from self.operating_point.problems(n, m)
        if self.limits is not None:
            yield from shape_problem("plant.limits", len(self.limits), n)
