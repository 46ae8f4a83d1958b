"""``[plant]``: what is simulated or driven, and what disturbs it."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field, field_validator

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
    """

    kind: Literal[
        "uniform", "corners", "truncated-gaussian", "gaussian", "constant", "sinusoid"
    ] = "uniform"
    half_widths: tuple[NotNegative, ...]
    deviation: Positive = 0.5
    bias: Annotated[float, Field(ge=-1, le=1)] = 1.0
    cycle_steps: Annotated[int, Field(ge=2)] = 20
    may_leave_defender_set: bool = False


class Plant(Part):
    """The plant that is simulated: x+ = A x + B u + d, every ``period_s`` seconds."""

    A: Matrix
    B: Matrix
    period_s: Positive
    initial_state: Vector
    disturbance: Disturbance

    _matrices = field_validator("A", "B")(check_matrix)

    def problems(self) -> Iterator[str]:
        """What does not fit ``len(A)`` states, a line each."""
        n, m = len(self.A), len(self.B[0])
        yield from shape_problem("plant.A", shape(self.A), (n, n))
        yield from shape_problem("plant.B", shape(self.B), (n, m))
        yield from shape_problem("plant.initial_state", len(self.initial_state), n)
        yield from shape_problem(
            "plant.disturbance.half_widths", len(self.disturbance.half_widths), n
        )
