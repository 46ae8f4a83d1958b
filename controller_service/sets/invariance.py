"""Whether a design's T_0 is robust invariant: asked of the sets as they are, whoever made them."""

from typing import Final, Literal

import numpy as np

from controller_service.sets.alphabet import Alphabet
from controller_service.sets.design import Design
from controller_service.sets.packed_design import kept, reduced
from controller_service.sets.recursion import recursion, support
from controller_service.sets.terminal import SynthesisError
from controller_service.sets.units import in_units
from protocol.convex import Polytope, SetError, corners
from protocol.scenario import Scenario
from protocol.scenario.laws import CERTAIN

TOLERANCE: Final = 1e-9
"""Fraction of itself, and of U, by which a set may reach beyond and still counts as inside."""


def invariance(scenario: Scenario, design: Design) -> Literal["gain", "control"] | None:
    """What keeps every state of T_0 within T_0, whatever d.

    A packed design is asked with its alphabet as part of d, and with U less the alphabet.

    Returns
    -------
    str or None
        ``gain`` where u = K x does and is in U; ``control`` where some u in U does; None where
        neither was found to, or where there are more than four states.
    """
    if scenario.n > 4:
        return None
    problem = (
        scenario if design.offsets is None else reduced(scenario, Alphabet(design.offsets, CERTAIN))
    )
    try:
        r = recursion(problem)
        T = r.enter(Polytope(*design.set(0)))
        V = corners(T.H, T.h)
        M = in_units(np.array(problem.A) + np.array(problem.B) @ design.K, r.units)
        needed = support(V @ M.T, T.H) + support(r.DV, T.H)
        H, h = (np.array(a) for a in problem.control.inputs.rows())
        used = support(corners(*design.set(0)) @ design.K.T, H)
        if (needed <= T.h * (1 + TOLERANCE)).all() and (used <= h * (1 + TOLERANCE)).all():
            return "gain"
        return "control" if kept(r, T) else None
    except (SetError, SynthesisError):
        return None
