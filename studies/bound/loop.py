"""The linear loop of a scenario with a packed alphabet, and where the bound of its coins holds."""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from controller_service.sets.alphabet import larger_disturbance
from controller_service.sets.packed_design import alphabet_of
from controller_service.sets.terminal import SynthesisError, feedback_gain, set_corners
from protocol.arrays import Array
from protocol.scenario import Scenario
from studies.bound.coins import Coin, largest_gain

Offers = Literal["none", "noisy", "clear"]

TERMS: Final = 4000
"""Steps over which a disturbance's reach is summed."""


class BoundError(ValueError):
    """A scenario that the bound says nothing about; one line that names the field."""


@dataclass(frozen=True, eq=False)
class LinearLoop:
    """x+ = A x + B (K x + p_b) + d, with what an input may need of U at most.

    Parameters
    ----------
    A, B, K : array, shapes (n, n), (n, m) and (m, n)
    offsets : array, shape (M, m)
    half_width : float
        The smallest half-width of D_c along a state: the unit of her noise in tables.
    used : float
        The most of U that K x + p ever needs, as a gauge: up to 1 no constraint is ever active.
    """

    A: Array
    B: Array
    K: Array
    offsets: Array
    half_width: float
    used: float

    @classmethod
    def of(cls, scenario: Scenario) -> "LinearLoop":
        """The loop of the scenario's regulator and alphabet.

        Raises
        ------
        BoundError
            When the scenario has no such loop.
        """
        if scenario.control.law != "packed":
            raise BoundError(
                f"control.law: got {scenario.control.law!r}, expected 'packed': the bound needs "
                "candidates that stand at fixed offsets"
            )
        if scenario.plant.kind != "linear" or scenario.defender.model is not None:
            raise BoundError(
                f"plant.kind: got {scenario.plant.kind!r}, expected 'linear' and no "
                "defender.model: the bound is about a linear loop"
            )
        try:
            alphabet = alphabet_of(scenario, getattr(scenario.control, "alphabet").spacing)  # noqa: B009
            K = feedback_gain(scenario)
        except SynthesisError as error:
            raise BoundError(str(error)) from None
        A, B = (np.array(matrix) for matrix in scenario.plant_model)
        if not float(np.abs(np.linalg.eigvals(A + B @ K)).max()) < 1:
            raise BoundError("control.gain: K does not stabilise the plant's own A and B")
        widths = np.ptp(set_corners(scenario.defender.disturbance), axis=0) / 2
        used = _used(scenario, A + B @ K, B, K, alphabet.offsets)
        return cls(A, B, K, alphabet.offsets, float(widths.min()), used)

    def coin(self, noise: float, offers: Offers = "none", states: tuple[int, ...] = ()) -> Coin:
        """The channel through which she sees each coin at best.

        Parameters
        ----------
        noise : float
            Standard deviation of her noise on every number that she reads, as ``tap.noise``.
        offers : str
            ``noisy``: she hears the offers' common part K x too, through the same noise.
            ``clear``: as it is sent.
        states : tuple of int
            The states that she watches, counted from 0; all by default.
        """
        if offers == "clear" or noise == 0:
            return Coin(self.offsets, 0.0)
        C = np.eye(len(self.A))[list(states)] if states else np.eye(len(self.A))
        if offers == "noisy":
            C = np.vstack([C, self.K])
        gain = largest_gain(self.A + self.B @ self.K, self.B, C / noise)
        return Coin(self.offsets, 1 / gain)


def _used(scenario: Scenario, F: Array, B: Array, K: Array, offsets: Array) -> float:
    """The largest gauge of U at K x + p, over every state that x = 0 can lead to."""
    H, h = (np.array(a) for a in scenario.control.inputs.rows())
    rows = H / h[:, None]
    pushed = larger_disturbance(scenario.defender.disturbance, B, offsets)
    corners = set_corners(pushed)
    reach = np.zeros(len(rows))
    along = rows @ K
    for _ in range(TERMS):
        more = (corners @ along.T).max(axis=0)
        reach += more
        along = along @ F
        if not (more > 1e-12 * reach).any():
            break
    return float((reach + (offsets @ rows.T).max(axis=0)).max())
