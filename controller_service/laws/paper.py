"""The law ``paper``: (27) as it stands, with u = K x inside T_0."""

import numpy as np

from controller_service.laws.base import ProgramLaw
from controller_service.laws.programs import products
from controller_service.sets.design import Design
from protocol.arrays import Array, Indices
from protocol.scenario import Scenario


class PaperLaw(ProgramLaw):
    """Programs outside T_0; inside, every candidate is K x, so nothing can be agreed there."""

    def __init__(self, scenario: Scenario, design: Design) -> None:
        super().__init__(scenario, design)
        self.copies = len(scenario.control.costs)
        self.inner = design.K.tolist()

    def gain(self, i: int) -> Array | None:
        """K inside T_0."""
        return self.design.K if i == 0 else None

    def answers_many(self, X: Array, indices: Indices) -> Array:
        """See :meth:`ProgramLaw.answers_many`."""
        out = np.repeat(products(self.design.K, X)[:, None, :], self.copies, axis=1)
        rest = np.flatnonzero(indices)
        if len(rest):
            out[rest] = self.programs.candidates_many(X[rest], indices[rest])
        return out
