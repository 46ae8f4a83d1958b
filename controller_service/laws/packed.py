"""The law ``packed``: one program for v, and every candidate of a fixed alphabet beside it.

The sets of the design allow for the alphabet as a disturbance: where v keeps the constraints of D'
and U', each v + p keeps those of D_c and U. So all M candidates are there at every state, for ever.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from controller_service.laws.base import ProgramLaw
from controller_service.sets.alphabet import smaller_inputs
from controller_service.sets.design import Design, Progress, synthesise
from controller_service.sets.packed_design import alphabet_of, reduced, search_terminal
from protocol.arrays import Array, Indices
from protocol.scenario import Scenario
from protocol.scenario.laws import PackedControl


class PackedLaw(ProgramLaw):
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
        super().__init__(scenario, design, inputs)
        self._offsets = design.offsets
        self._pushes = [tuple(p) for p in design.offsets.tolist()]

    @classmethod
    def synthesise(cls, scenario: Scenario, progress: Progress | None = None) -> Design:
        """The sets for D' and U', with the alphabet; see :meth:`ProgramLaw.synthesise`."""
        control = scenario.control
        assert isinstance(control, PackedControl)
        alphabet = alphabet_of(scenario, control.alphabet.spacing)
        design = synthesise(reduced(scenario, alphabet), progress, search_terminal)
        return replace(design, offsets=alphabet.offsets)

    def answers(self, x: Sequence[float], i: int) -> tuple[tuple[float, ...], ...]:
        """v(x) + p_0, v(x) + p_1, ..., each of m inputs; see :meth:`ProgramLaw.answers`."""
        v = super().answers(x, i)[0]
        if len(v) == 1:
            (u,) = v
            return tuple([(u + p,) for (p,) in self._pushes])
        return tuple([tuple([a + b for a, b in zip(v, p, strict=True)]) for p in self._pushes])

    def answers_many(self, X: Array, indices: Indices) -> Array:
        """The same for each row, shape (R, M, m)."""
        return np.asarray(super().answers_many(X, indices) + self._offsets)
