"""`nearer`: the candidates of the two costs, each moved towards their middle."""

import numpy as np

from controller_service.laws.base import ProgramLaw
from protocol.scenario import Control


class NearerControl(Control):
    share: float = 0.25
    """How much of the way to the middle: 0 none, 1 all of it."""


class Nearer(ProgramLaw):
    table = NearerControl

    def __init__(self, scenario, design):
        super().__init__(scenario, design)
        self.share = scenario.control.share

    def answers(self, x, i):
        found = self.answers_many(np.array([x], dtype=float), np.array([i]))[0]
        return tuple(tuple(u) for u in found.tolist())

    def answers_many(self, X, indices):
        u = super().answers_many(X, indices)  # shape (R, M, m)
        middle = u.mean(axis=1, keepdims=True)
        return u + self.share * (middle - u)
