"""What a control law is: a set index and M candidate inputs for a state, or for many states.

Whoever needs candidates asks a :class:`CandidateLaw`: the service, the engine, the checker. A law
that solves programs on a design's sets extends :class:`ProgramLaw`; both laws of (27) do.
"""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from controller_service.laws.errors import OutsideError, ProgramError
from controller_service.laws.planar import Planar
from controller_service.laws.programs import General, Quadratic
from controller_service.sets.design import Design, Progress, input_interval, synthesise
from controller_service.sets.gains import advised_start
from protocol.arrays import Array, Indices
from protocol.scenario import Cost, Scenario
from protocol.scenario.sets import ConvexSet


class CandidateLaw(Protocol):
    """One scenario's law on its design.

    Parameters
    ----------
    design : Design
        The sets T_i, and the targets that the law's candidates keep.
    """

    @property
    def design(self) -> Design: ...  # noqa: D102

    def index(self, x: Sequence[float]) -> int:
        """i(k) = min { i : x in T_i }, x of shape (n,).

        Raises
        ------
        OutsideError
            When x is in no T_i.
        """

    def candidates(self, x: Sequence[float]) -> tuple[tuple[float, ...], ...]:
        """The M candidates at x, each of m inputs.

        Raises
        ------
        OutsideError
            When x is in no T_i.
        ProgramError
            When no input satisfies the constraints.
        """

    def indices(self, X: ArrayLike) -> Indices:
        """i(k) of each row of X, shape (R, n); the same as :meth:`index`.

        Raises
        ------
        OutsideError
            When a row is in no T_i.
        """

    def candidates_many(self, X: ArrayLike, indices: Indices | None = None) -> Array:
        """The candidates of each row, shape (R, M, m); the same as :meth:`candidates`.

        Parameters
        ----------
        X : array, shape (R, n)
        indices : array, shape (R,), optional
            What :meth:`indices` returned for X.

        Raises
        ------
        OutsideError, ProgramError
            As :meth:`candidates`.
        """

    def gain(self, i: int) -> Array | None:
        """K, shape (m, n), where every candidate of index i is K x; None elsewhere."""


class Programs(Protocol):
    """What a law asks of a solver: index and one input for each cost, of one state or of many."""

    def index(self, x: Sequence[float]) -> int: ...  # noqa: D102

    def candidates(self, x: Sequence[float], i: int) -> tuple[tuple[float, ...], ...]: ...  # noqa: D102

    def excess(self, x: Sequence[float]) -> float: ...  # noqa: D102

    def indices(self, X: Array) -> Indices: ...  # noqa: D102

    def candidates_many(self, X: Array, indices: Indices) -> Array: ...  # noqa: D102


class ProgramLaw:
    """Candidates phi_0(x), phi_1(x), ... that minimise one cost each, at every index.

    At index 0 the target is T_0 ~ D_c: T_0 is robust invariant, so the programs are feasible.
    ``inner`` has the rows of a K where every candidate at index 0 is K x, ``copies`` times.

    Parameters
    ----------
    scenario : Scenario
    design : Design
    inputs : ConvexSet, optional
        What the programs' inputs are taken from, ``control.inputs`` if not given.

    Raises
    ------
    ProgramError
        When a cost has no unique minimiser.
    """

    inner: Sequence[Sequence[float]] = ()
    copies = 0

    def __init__(self, scenario: Scenario, design: Design, inputs: ConvexSet | None = None) -> None:
        self.design = design
        costs = scenario.control.costs
        U = scenario.control.inputs if inputs is None else inputs
        for j, cost in enumerate(costs):
            try:
                Quadratic.of(design.A, design.B, cost)
            except ValueError as error:
                raise ProgramError(f"control.costs.{j}: {error}") from None
        self.programs: Programs = _programs(design, U, costs)
        self._N = design.horizon

    @classmethod
    def synthesise(cls, scenario: Scenario, progress: Progress | None = None) -> Design:
        """The sets that this law needs; a law with sets of its own overrides it.

        Raises
        ------
        SynthesisError
            With one line, when there are none.
        """
        return synthesise(scenario, progress, advised_start)

    def index(self, x: Sequence[float]) -> int:
        """See :meth:`CandidateLaw.index`."""
        i = self.programs.index(x)
        if i > self._N:
            raise self._outside(x)
        return i

    def candidates(self, x: Sequence[float]) -> tuple[tuple[float, ...], ...]:
        """See :meth:`CandidateLaw.candidates`."""
        i = self.index(x)
        try:
            return self.answers(x, i)
        except ValueError as error:
            raise ProgramError(f"at x = {list(x)}, index {i}: {error}") from None

    def answers(self, x: Sequence[float], i: int) -> tuple[tuple[float, ...], ...]:
        """The candidates at x of index i; ValueError when no input is left."""
        if i > 0 or not self.inner:
            return self.programs.candidates(x, i)
        u = []
        for row in self.inner:
            # From the left, product by product: to the last bit what many states get.
            total = row[0] * float(x[0])
            for k, v in zip(row[1:], x[1:], strict=True):
                total = total + k * float(v)
            u.append(total)
        return (tuple(u),) * self.copies

    def indices(self, X: ArrayLike) -> Indices:
        """See :meth:`CandidateLaw.indices`."""
        rows = np.asarray(X, dtype=float)
        out = self.programs.indices(rows)
        outside = out > self._N
        if outside.any():
            raise self._outside(rows[int(outside.argmax())].tolist())
        return out

    def candidates_many(self, X: ArrayLike, indices: Indices | None = None) -> Array:
        """See :meth:`CandidateLaw.candidates_many`."""
        rows = np.asarray(X, dtype=float)
        found = self.indices(rows) if indices is None else indices
        try:
            return self.answers_many(rows, found)
        except ValueError as error:
            raise ProgramError(str(error)) from None

    def gain(self, i: int) -> Array | None:  # noqa: ARG002
        """See :meth:`CandidateLaw.gain`."""
        return None

    def answers_many(self, X: Array, indices: Indices) -> Array:
        """The candidates of each row, shape (R, M, m); ValueError when no input is left."""
        return self.programs.candidates_many(X, indices)

    def _outside(self, x: Sequence[float]) -> OutsideError:
        # The look-up's rounding and this one's differ: at an edge the excess may come out negative.
        excess = max(0.0, self.programs.excess(x))
        return OutsideError(
            f"the state {[float(v) for v in x]} is outside T_{self._N}, the largest set: it lies "
            f"{excess:.6g} beyond a facet"
        )


def _programs(design: Design, inputs: ConvexSet, costs: Sequence[Cost]) -> Programs:
    if design.B.shape == (2, 1) and design.B.any():
        return Planar(design, *input_interval(inputs), costs)
    return General(design, inputs, costs)
