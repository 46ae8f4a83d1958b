"""How long a dead link may last: steps from T_0 under the fallback until outside T_N."""

from typing import Final

import numpy as np

from controller_service.sets.design import Design
from controller_service.sets.terminal import set_corners
from protocol.convex import corners
from protocol.scenario import Scenario

MOST_STEPS: Final = 1000
"""Steps after which a budget is not looked for any further."""


def dead_link_budget(scenario: Scenario, design: Design) -> int | None:
    """Steps without an offer that every state of T_0 surely survives, in the worst case of d.

    The state of step k under ``zero`` is A^k x + sum A^i d_i; under ``hold`` besides sum A^i B u
    for any u in U; under ``regulator`` T_0 is invariant, as K T_0 lies within U. The largest value
    of each row of T_N over all of them is compared with its bound.

    Returns
    -------
    int or None
        0 where T_0 was not made for the stated gain, so that nothing is known; None where no
        number of steps up to :data:`MOST_STEPS` leads outside.
    """
    if scenario.link.fallback == "regulator":
        gain = scenario.control.gain
        return None if gain is not None and np.array_equal(design.K, gain) else 0
    A = design.A
    H, h = design.set(design.horizon)
    V = corners(*design.set(0))
    D = set_corners(scenario.control_set)
    U = set_corners(scenario.control.inputs) @ design.B.T
    held = scenario.link.fallback == "hold"
    forward = np.eye(len(A))
    summed = np.zeros_like(A)
    pushed = np.zeros(len(h))
    for k in range(1, MOST_STEPS + 1):
        pushed = pushed + (D @ forward.T @ H.T).max(axis=0)
        summed = summed + forward
        forward = forward @ A
        reach = (V @ forward.T @ H.T).max(axis=0) + pushed
        if held:
            reach = reach + (U @ summed.T @ H.T).max(axis=0)
        if not (reach <= h * (1 + 1e-12)).all():
            return k - 1
    return None
