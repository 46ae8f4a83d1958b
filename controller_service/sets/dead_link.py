"""How long a dead link may last: steps from T_0 under the fallback until outside T_N."""

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from controller_service.sets.design import Design
from controller_service.sets.recursion import support
from controller_service.sets.terminal import set_corners
from protocol.arrays import Array
from protocol.convex import Polytope, corners, planar_reduce, planar_support
from protocol.scenario import Scenario

MOST_STEPS: Final = 1000
"""Steps after which a budget is not looked for any further."""


def _support_of(H: ArrayLike, h: ArrayLike) -> Callable[[Array], Array]:
    """The support function of a set; in the plane by angle, for it may have many corners."""
    p = Polytope.from_rows(H, h)
    if p.dimension == 2:
        planar = planar_reduce(p.H, p.h)
        return lambda directions: planar_support(planar, directions)
    V = corners(p.H, p.h)
    return lambda directions: support(V, directions)


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
    start = _support_of(*design.set(0))
    disturbance = _support_of(*scenario.control_set.rows())
    U = set_corners(scenario.control.inputs) @ design.B.T
    held = scenario.link.fallback == "hold"
    forward = np.eye(len(A))
    summed = np.zeros_like(A)
    pushed = np.zeros(len(h))
    for k in range(1, MOST_STEPS + 1):
        pushed = pushed + disturbance(H @ forward)
        summed = summed + forward
        forward = forward @ A
        reach = start(H @ forward) + pushed
        if held:
            reach = reach + (U @ summed.T @ H.T).max(axis=0)
        if not (reach <= h * (1 + 1e-12)).all():
            return k - 1
    return None
