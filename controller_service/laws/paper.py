"""The two control laws of (27), evaluated at one state or at many.

``paper`` applies u = K x inside T_0. ``sustained`` goes on solving both programs there, with
T_0 ~ D_c as their target: T_0 is robust invariant, so the programs are feasible.
"""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controller_service.laws.planar import Planar
from controller_service.laws.programs import General, Quadratic
from controller_service.sets.design import Design, input_interval
from protocol.convex import Array, Polytope
from protocol.scenario import Scenario

Indices = NDArray[np.intp]


class OutsideError(LookupError):
    """A state outside every T_i; the message names the state, the largest set and the distance."""


class ProgramError(LookupError):
    """A program without an answer that satisfies its constraints."""


class Programs(Protocol):
    """What a law asks of a solver: index and one input for each cost."""

    def index(self, x: Sequence[float]) -> int: ...  # noqa: D102

    def candidates(self, x: Sequence[float], i: int) -> tuple[tuple[float, ...], ...]: ...  # noqa: D102

    def indices(self, X: Array) -> Indices: ...  # noqa: D102

    def candidates_many(self, X: Array, indices: Indices) -> Array: ...  # noqa: D102


class ControlLaw:
    """One scenario's law: i(k) and the candidates phi_0(x), phi_1(x), ..., one for each cost.

    Raises
    ------
    ProgramError
        When a cost has no unique minimiser.
    """

    def __init__(self, scenario: Scenario, design: Design) -> None:
        self.design = design
        control = scenario.control
        sustained = control.law == "sustained"
        self.programs: Programs
        for j, cost in enumerate(control.costs):
            try:
                Quadratic.of(design.A, design.B, cost)
            except ValueError as error:
                raise ProgramError(f"control.costs.{j}: {error}") from None
        if scenario.n == 2 and scenario.m == 1 and design.B.any():
            limits = input_interval(control.inputs)
            self.programs = Planar(design, *limits, control.costs, sustained)
        else:
            self.programs = General(design, control.inputs, control.costs, sustained)
        self._N = design.horizon

    def index(self, x: Sequence[float]) -> int:
        """i(k) = min { i : x in T_i }, x of shape (n,).

        Raises
        ------
        OutsideError
            When x is in no T_i.
        """
        i = self.programs.index(x)
        if i > self._N:
            raise self._outside(x)
        return i

    def candidates(self, x: Sequence[float]) -> tuple[tuple[float, ...], ...]:
        """phi_0(x), phi_1(x), ..., each of m inputs.

        Raises
        ------
        OutsideError
            When x is in no T_i.
        ProgramError
            When no input satisfies the constraints.
        """
        i = self.index(x)
        try:
            return self.programs.candidates(x, i)
        except ValueError as error:
            raise ProgramError(f"at x = {list(x)}, index {i}: {error}") from None

    def indices(self, X: ArrayLike) -> Indices:
        """i(k) of each row of X, shape (R, n); the same as :meth:`index`.

        Raises
        ------
        OutsideError
            When a row is in no T_i.
        """
        rows = np.asarray(X, dtype=float)
        out = self.programs.indices(rows)
        outside = out > self._N
        if outside.any():
            raise self._outside(rows[int(outside.argmax())].tolist())
        return out

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
        rows = np.asarray(X, dtype=float)
        found = self.indices(rows) if indices is None else indices
        try:
            return self.programs.candidates_many(rows, found)
        except ValueError as error:
            raise ProgramError(str(error)) from None

    def _outside(self, x: Sequence[float]) -> OutsideError:
        # The look-up's rounding and this one's differ: at an edge the excess may come out negative.
        excess = max(0.0, Polytope(*self.design.set(self._N)).excess(x))
        return OutsideError(
            f"the state {[float(v) for v in x]} is outside T_{self._N}, the largest set: it lies "
            f"{excess:.6g} beyond a facet"
        )


def make_law(scenario: Scenario, design: Design) -> ControlLaw:
    """The law ``control.law`` of the scenario, on its design."""
    if scenario.control.law == "packed":
        from controller_service.laws.packed import PackedLaw

        return PackedLaw(scenario, design)
    return ControlLaw(scenario, design)
