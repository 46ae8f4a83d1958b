"""The law ``packed``: one program for v, and every candidate of a fixed alphabet beside it.

The sets of the design allow for the alphabet as a disturbance: where v keeps the constraints of D'
and U', each v + p keeps those of D_c and U. So all M candidates are there at every state, for ever.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from controller_service.laws.paper import ControlLaw, Indices
from controller_service.sets.alphabet import smaller_inputs
from controller_service.sets.design import Design
from protocol.convex import Array
from protocol.scenario import Scenario


class PackedLaw(ControlLaw):
    """i(k) and the candidates v(x) + p_0, v(x) + p_1, ...; v minimises the one cost.

    The mean over the alphabet of a quadratic cost is that of v and a constant, so the plain program
    is also the best one for the candidates together.

    Raises
    ------
    ProgramError
        When the cost has no unique minimiser.
    """

    def __init__(self, scenario: Scenario, design: Design) -> None:
        assert design.offsets is not None
        inputs = smaller_inputs(scenario.control.inputs, design.offsets)
        assert inputs is not None
        control = scenario.control.model_copy(update={"inputs": inputs, "law": "sustained"})
        super().__init__(scenario.model_copy(update={"control": control}), design)
        self._offsets = design.offsets
        self._pushes = [tuple(p) for p in design.offsets.tolist()]

    def candidates(self, x: Sequence[float]) -> tuple[tuple[float, ...], ...]:
        """v(x) + p_0, v(x) + p_1, ..., each of m inputs; see :meth:`ControlLaw.candidates`."""
        v = super().candidates(x)[0]
        if len(v) == 1:
            (u,) = v
            return tuple([(u + p,) for (p,) in self._pushes])
        return tuple([tuple([a + b for a, b in zip(v, p, strict=True)]) for p in self._pushes])

    def candidates_many(self, X: ArrayLike, indices: Indices | None = None) -> Array:
        """The candidates of each row, shape (R, M, m); the same as :meth:`candidates`."""
        return np.asarray(super().candidates_many(X, indices) + self._offsets)
