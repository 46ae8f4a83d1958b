"""A gain that gives a terminal set, for a scenario whose own gives none.

Tried are regulators with a prescribed degree of stability: the linear quadratic regulator of
A / rho and B / rho, whose closed loop decays by at least rho a step (Anderson and Moore, *Optimal
Control: Linear Quadratic Methods*, section 3.5). rho = 1 is the plain regulator.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from controller_service.sets.design import Start, invariant_start, stated_start
from controller_service.sets.terminal import (
    SynthesisError,
    TooThinError,
    regulator_gain,
    set_corners,
)
from controller_service.sets.units import state_units
from protocol.arrays import Array
from protocol.convex import SetError
from protocol.scenario import ConvexSet, Regulator, Scenario

DECAYS: Final = (1.0, 0.98, 0.95, 0.9, 0.85, 0.8, 0.7, 0.6, 0.5)
"""rho, the slowest first: a slow loop has a wide T_0, and room between the candidates."""

WEIGHTS: Final = (10.0, 1.0, 0.1, 0.01, 0.001, 0.0001)
"""Factors on the weights of the input, the softest gain first."""

SHARES: Final = (1.0, 0.4, 0.2, 0.1, 0.04, 0.02, 0.01, 0.004, 0.002, 0.001)
"""Parts of the disturbance for which a gain is looked for, the largest first."""

DIGITS: Final = 4
"""Significant digits of a gain that is advised: it is tried as it is written."""


@dataclass(frozen=True, eq=False)
class FoundGain:
    """A gain that was tried and gives a terminal set.

    Parameters
    ----------
    K : array, shape (m, n)
        The gain of u = K x, rounded as :meth:`advice` writes it.
    decay : float
        rho: the loop decays at least so fast, a factor a step.
    share : float
        The part of the disturbance for which it does; 1 is the scenario's own.
    """

    K: Array
    decay: float
    share: float

    def written(self) -> str:
        """K as the scenario file says it."""
        return _rows(self.K)

    def advice(self, scenario: Scenario) -> str:
        """What to write into the scenario's file."""
        stated = "[control.regulator]" if scenario.control.gain is None else "today's"
        text = f"control.gain = {self.written()} in place of {stated} gives one"
        if self.share < 1:
            name = "defender" if scenario.control.disturbance is None else "control"
            text += f", with {name}.disturbance (and plant.disturbance) {self.share:g} of today's"
        return text


def advised_start(scenario: Scenario) -> Start:
    """K and T_0 as :func:`stated_start` gives them; a refusal names a gain that was found to do.

    Raises
    ------
    SynthesisError
        With one line, when the stated gain or weights give no terminal set.
    """
    try:
        return stated_start(scenario)
    except TooThinError:
        raise
    except SynthesisError as error:
        found = find_gain(scenario)
        if found is None:
            raise
        raise SynthesisError(f"{error}; {found.advice(scenario)}") from None


def find_gain(scenario: Scenario, shares: Sequence[float] = SHARES) -> FoundGain | None:
    """The softest gain that gives a terminal set for most of the disturbance; None if none does.

    Parameters
    ----------
    scenario : Scenario
    shares : sequence of float
        Parts of the disturbance to be tried, the largest first.

    Notes
    -----

    T_0 grows in proportion to the disturbance. So each gain's set is made once, and its reach
    towards U and the state bounds says up to which share of the disturbance it serves.
    """
    tried = [(decay, K, _served(K, scenario)) for decay, K in gains(scenario)]
    for share in shares:
        for decay, K, served in tried:
            if share <= served and _gives(K, scenario, share):
                return FoundGain(K, decay, share)
    return None


def gains(scenario: Scenario) -> Iterator[tuple[float, Array]]:
    """rho and K of each regulator that is tried, the softest first, as they are written."""
    stated = scenario.control.regulator
    weights = stated or plain_weights(scenario)
    A, B, Q = np.array(scenario.A), np.array(scenario.B), np.diag(weights.next_state)
    for decay in DECAYS:
        for factor in WEIGHTS:
            R = factor * np.diag(weights.input)
            try:
                K = regulator_gain(A / decay, B / decay, Q, R)
            except SynthesisError:
                continue
            yield decay, np.array([[float(f"{v:.{DIGITS}g}") for v in row] for row in K])


def plain_weights(scenario: Scenario) -> Regulator:
    """Weights of one, for each state in the unit in which its sets are computed."""
    units = state_units(np.array(scenario.A), set_corners(scenario.control_set))
    states = np.ones(scenario.n) if units is None else units**-2.0
    return Regulator(next_state=tuple(states.tolist()), input=(1.0,) * scenario.m)


def _served(K: Array, scenario: Scenario) -> float:
    """The largest share of the disturbance for which K may give a terminal set; 0 for none."""
    try:
        reaches = invariant_start(K, scenario).reaches
    except (SynthesisError, SetError):
        return 0.0
    return 1 / max(float(reach.max()) for reach in reaches)


def _gives(K: Array, scenario: Scenario, share: float) -> bool:
    """Whether the gain as it is written gives a terminal set for that share."""
    try:
        stated_start(with_gain(scenario, K, share))
    except SynthesisError:
        return False
    return True


def with_gain(scenario: Scenario, K: Array, share: float = 1.0) -> Scenario:
    """The scenario with a stated gain, its sets made for a share of the disturbance."""
    rows = tuple(tuple(float(v) for v in row) for row in K)
    resisted: ConvexSet = scenario.control_set.scaled(share)
    update = {"gain": rows, "regulator": None, "disturbance": resisted}
    return scenario.model_copy(update={"control": scenario.control.model_copy(update=update)})


def _rows(K: Array) -> str:
    return "[" + ", ".join("[" + ", ".join(f"{v:g}" for v in row) + "]" for row in K) + "]"
