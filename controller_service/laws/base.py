"""What a control law is: a set index and M candidate inputs for a state, or for many states.

Whoever needs candidates asks a :class:`CandidateLaw`: the service, the engine, the checker. A law
that solves programs on a design's sets extends :class:`ProgramLaw`; both laws of (27) do.
"""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from controller_service.laws.online import OneState, ProgramError, Solver
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


class Programs(Solver, Protocol):
    """What a law asks of a solver: index and one input for each cost."""

    def indices(self, X: Array) -> Indices: ...  # noqa: D102

    def candidates_many(self, X: Array, indices: Indices) -> Array: ...  # noqa: D102


class ProgramLaw(OneState):
    """Candidates phi_0(x), phi_1(x), ... that minimise one cost each, at every index.

    At index 0 the target is T_0 ~ D_c: T_0 is robust invariant, so the programs are feasible.

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


def _programs(design: Design, inputs: ConvexSet, costs: Sequence[Cost]) -> Programs:
    if design.B.shape == (2, 1) and design.B.any():
        return Planar(design, *input_interval(inputs), costs)
    return General(design, inputs, costs)
