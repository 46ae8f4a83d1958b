"""The linear loop of a scenario with a packed alphabet, and the channel of its coins."""

from dataclasses import dataclass

import numpy as np

from controller_service.sets.packed_design import alphabet_of
from controller_service.sets.terminal import feedback_gain, set_corners
from protocol.arrays import Array
from protocol.scenario import Scenario
from studies.bound.coins import Coin, largest_gain


@dataclass(frozen=True, eq=False)
class LinearLoop:
    """x+ = A x + B (K x + p_b) + d.

    Parameters
    ----------
    A, B, K : array, shapes (n, n), (n, m) and (m, n)
    offsets : array, shape (M, m)
    half_width : float
        The smallest half-width of D_c along a state: the unit of her noise in tables.
    """

    A: Array
    B: Array
    K: Array
    offsets: Array
    half_width: float

    @classmethod
    def of(cls, scenario: Scenario) -> "LinearLoop":
        """The loop of the scenario's regulator and alphabet; its law is `packed`."""
        alphabet = alphabet_of(scenario, getattr(scenario.control, "alphabet").spacing)  # noqa: B009
        A, B = (np.array(matrix) for matrix in scenario.plant_model)
        widths = np.ptp(set_corners(scenario.defender.disturbance), axis=0) / 2
        return cls(A, B, feedback_gain(scenario), alphabet.offsets, float(widths.min()))

    def coin(self, noise: float) -> Coin:
        """The channel through which she sees each coin at best.

        Parameters
        ----------
        noise : float
            Standard deviation of her noise on every state that she reads, as ``tap.noise``.
        """
        C = np.eye(len(self.A)) / noise
        return Coin(self.offsets, 1 / largest_gain(self.A + self.B @ self.K, self.B, C))
