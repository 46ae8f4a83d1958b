"""``[defender]``: the identified model that the agreement test asks."""

from collections.abc import Iterator
from typing import Annotated

from pydantic import Field

from protocol.scenario.noise import NoiseSet
from protocol.scenario.parts import Positive, ScenarioTable, shape, shape_problem
from protocol.scenario.plant import Disturbance
from protocol.scenario.sets import Resisted, set_problem
from protocol.vectors import FiniteMatrix


class Calibration(ScenarioTable):
    """What ``wyner fit`` promises of D_c, and under which law it found it.

    A session of ``steps`` steps leaves D_c with probability at most ``violation``, at this
    ``confidence``: of ``sessions`` fresh ones ``exceeded`` did. Not part of the fingerprint.
    """

    sessions: Annotated[int, Field(ge=1)]
    """Fresh sessions that were recorded."""
    steps: Annotated[int, Field(ge=1)]
    """Steps of each."""
    exceeded: Annotated[int, Field(ge=0)]
    """How many of them left D_c."""
    violation: Annotated[float, Field(gt=0, le=1)]
    """Bound on the probability that a session leaves D_c."""
    confidence: Annotated[float, Field(gt=0, lt=1)]
    """How sure that bound is."""
    law_fingerprint: str
    """SHA-256 of what the calibration was made under; another law makes it stale."""


class Defender(ScenarioTable):
    """The identified model (5): A and B (the plant's own where not given) and D_c."""

    A: FiniteMatrix | None = None
    """State matrix of the identified model; the plant's own where not given."""
    B: FiniteMatrix | None = None
    """Input matrix of the identified model; the plant's own where not given."""
    model: str | None = None
    """A nonlinear f_c: the function predict(x, u), as 'file.py:predict'; A and B linearise it."""
    disturbance: Resisted
    """D_c, which both ends know and Eve does not: it decides what a key is."""
    deviations: tuple[Positive, ...] | None = None
    """Standard deviations of a Gaussian d, n numbers: a symbol is then the likeliest candidate."""
    noise: NoiseSet | None = None
    """N, what both ends take the sensors to add at most; none where not given."""
    bounds: tuple[Positive, ...] | None = None
    """Where plant.C is given: half-widths of a box that the state never leaves, n numbers."""
    calibration: Calibration | None = None
    """What `wyner fit` promises of D_c."""

    def problems(self, n: int, m: int, readings: int) -> Iterator[str]:
        """What does not fit a plant of ``n`` states, ``m`` inputs and so many readings."""
        if self.A is not None:
            yield from shape_problem("defender.A", shape(self.A), (n, n))
        if self.B is not None:
            yield from shape_problem("defender.B", shape(self.B), (n, m))
        yield from set_problem("defender.disturbance", self.disturbance, n)
        yield from set_problem("defender.noise", self.noise, readings)
        if self.bounds is not None:
            yield from shape_problem("defender.bounds", len(self.bounds), n)
        if self.deviations is not None:
            yield from shape_problem("defender.deviations", len(self.deviations), n)
            if self.noise is not None:
                yield "defender.deviations: expected none beside defender.noise"

    def covers(self, d: Disturbance) -> bool:
        """Whether the box that ``d`` is drawn from lies within D_c."""
        for row, bound in zip(*self.disturbance.rows(), strict=True):
            reach = sum(abs(a) * w for a, w in zip(row, d.half_widths, strict=True))
            if reach > bound * (1 + 1e-12):
                return False
        return True
