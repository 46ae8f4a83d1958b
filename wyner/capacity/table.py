"""What a plant's inputs can carry by the paper's rule, over alpha: sizes, bounds and the price.

All bits are claimed by the possibilistic rule of the paper, for keys that are functions of the
applied input: without that condition the rule allows any number of keys at any alpha above 1
(``studies/capacity/void.py``). What an eavesdropper who compares distances leaves of them is
nothing; see docs/findings.md.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from controller_service.sets.alphabet import (
    Ceiling,
    ceilings,
    choose_alphabet,
    control_allows,
    half_width,
    input_length,
    largest_certain,
    line_offsets,
)
from controller_service.sets.grid_alphabet import polygon_rows
from controller_service.sets.separation import AlphabetError, Separation
from controller_service.sets.terminal import SynthesisError, feedback_gain
from protocol.arrays import Array
from protocol.convex import SetError, corners
from protocol.scenario import Scenario
from wyner.capacity.betting import Bet, DisturbanceLaw, best_bet


@dataclass(frozen=True)
class Price:
    """What dither of variance 1 on each input adds, where no constraint is active.

    Parameters
    ----------
    state, input : tuple of float, length m
        kx and ku: mean of x'x and of u'u, from the Lyapunov equation of x+ = (A + B K) x + B p.
    """

    state: tuple[float, ...]
    input: tuple[float, ...]


@dataclass(frozen=True)
class CapacityRow:
    """One alpha.

    Parameters
    ----------
    alpha : float
    certain : int
        The most candidates of which every transition agrees.
    held : int
        Of these, what U and control's ceiling leave room for.
    bound : int
        No alphabet is larger (m = 1: no key that is a function of the applied input has more
        values).
    bet : Bet or None
        The best alphabet for the scenario's own law of d; one input and a box D_c only.
    erasures : float or None
        log2(ceil(alpha) - 1), the supremum of long alphabets that are certain but at their ends;
        one input only.
    volume : float
        m log2(alpha): no code of offsets fixed in advance carries more, over any number of steps.
    chained : float or None
        What codes over ever more steps come to: log2(alpha) above 2, else 0; one input only.
    state_price, input_price : float
        What the alphabet of ``held`` candidates adds to the means of x'x and u'u.
    """

    alpha: float
    certain: int
    held: int
    bound: int
    bet: Bet | None
    erasures: float | None
    volume: float
    chained: float | None
    state_price: float | None
    input_price: float | None

    @property
    def bits(self) -> float:
        """Certain bits a transition."""
        return math.log2(self.held)


@dataclass(frozen=True)
class Capacity:
    """A scenario's table.

    Parameters
    ----------
    sigma : float or None
        Spacing of certain candidates, as an input; one input only.
    ceilings : tuple of Ceiling
        Control's own, one for each real mode that does not decay.
    price : Price or None
        None where no stabilising gain is known.
    rows : tuple of Row
    """

    sigma: float | None
    ceilings: tuple[Ceiling, ...]
    price: Price | None
    rows: tuple[CapacityRow, ...]


def added(A: Array, B: Array, K: Array, covariance: Array) -> tuple[float, float]:
    """What dither of this covariance, shape (m, m), adds to the means of x'x and u'u."""
    from scipy.linalg import solve_discrete_lyapunov

    S = solve_discrete_lyapunov(A + B @ K, B @ covariance @ B.T)
    return float(np.trace(S)), float(np.trace(K @ S @ K.T) + np.trace(covariance))


def dither_price(A: Array, B: Array, K: Array) -> Price:
    """kx and ku of the loop u = K x + p, of p on each input alone."""
    units = np.eye(B.shape[1])
    pairs = [added(A, B, K, np.outer(unit, unit)) for unit in units]
    return Price(tuple(x for x, _ in pairs), tuple(u for _, u in pairs))


def gain_of(scenario: Scenario) -> Array | None:
    """The scenario's gain or regulator's; None where it has none that stabilises."""
    try:
        return feedback_gain(scenario)
    except SynthesisError:
        return None


def capacity(scenario: Scenario, alphas: Sequence[float]) -> Capacity:
    """The table of a scenario with one or two inputs.

    Raises
    ------
    SynthesisError
        When a set is not compact, or there are more inputs or dependent ones.
    """
    D_c, U = scenario.defender.disturbance, scenario.control.inputs
    try:
        if scenario.secrecy.disturbance is not None:
            raise AlphabetError(
                "secrecy.disturbance: expected none, as the table is over alpha with "
                "D_e = alpha D_c"
            )
        if scenario.m > 2:
            raise AlphabetError(f"plant.B: got {scenario.m} inputs, expected 1 or 2")
        sep = Separation.of(scenario.B, D_c)
        limits = ceilings(scenario.A, scenario.B, scenario.control_set, U)
        K = gain_of(scenario)
        rows = [_row(scenario, sep, limits, K, alpha) for alpha in alphas]
    except (AlphabetError, SetError) as error:
        raise SynthesisError(str(error)) from None
    price = None
    if K is not None:
        price = dither_price(np.array(scenario.A), np.array(scenario.B), K)
    return Capacity(sep.sigma() if sep.inputs == 1 else None, limits, price, tuple(rows))


def _row(
    scenario: Scenario,
    sep: Separation,
    limits: tuple[Ceiling, ...],
    K: Array | None,
    alpha: float,
) -> CapacityRow:
    D_c, U = scenario.defender.disturbance, scenario.control.inputs
    certain = largest_certain(sep, alpha)
    held, offsets = certain, np.zeros((1, sep.inputs))
    while held > 1:
        try:
            chosen = choose_alphabet(scenario.B, D_c, U, alpha=alpha, size=held)
        except AlphabetError:
            held -= 1
            continue
        if control_allows(limits, scenario.B, chosen.offsets):
            offsets = chosen.offsets
            break
        held -= 1
    one = sep.inputs == 1
    bet = None
    d = scenario.plant.disturbance
    if one and D_c.half_widths is not None and sep.sigma() < math.inf:
        bet = best_bet(
            np.array(scenario.B)[:, 0],
            sep.sigma(),
            np.array(D_c.half_widths),
            alpha,
            DisturbanceLaw.of(d),
            length=_room(sep, limits, scenario),
            certain=held,
        )
    costs = None
    if K is not None:
        covariance = np.cov(offsets.T, bias=True).reshape(sep.inputs, sep.inputs)
        costs = added(np.array(scenario.A), np.array(scenario.B), K, covariance)
    return CapacityRow(
        alpha=alpha,
        certain=certain,
        held=held,
        bound=max(1, math.ceil(sep.omega(alpha) / sep.sigma())) if one else plane_bound(sep, alpha),
        bet=bet,
        erasures=math.log2(max(1, math.ceil(alpha) - 1)) if one else None,
        volume=sep.inputs * math.log2(alpha),
        chained=(math.log2(alpha) if alpha > 2 else 0.0) if one else None,
        state_price=None if costs is None else costs[0],
        input_price=None if costs is None else costs[1],
    )


def plane_bound(sep: Separation, alpha: float) -> int:
    """No alphabet of two inputs is larger.

    Where both polygons are one parallelogram but for its size, the count along both edges. Else by
    Brunn's inequality: around points p of an alphabet the sets p + S / 2 are disjoint, within a set
    X with X - X in W + S, and 4 vol X is at most vol(X - X).
    """
    if not sep.room(alpha) > 0:
        return 1
    apart, together = polygon_rows(sep.apart), polygon_rows(sep.together_at(alpha))
    if len(apart) == len(together) == 2:
        counts = np.linalg.norm(apart, axis=1) / np.linalg.norm(together, axis=1)
        if np.allclose(apart, together * counts[:, None], rtol=0, atol=1e-12 * np.abs(apart).max()):
            return int(np.maximum(1, np.ceil(counts)).prod())
    from scipy.spatial import ConvexHull

    S, W = (corners(np.vstack([r, -r]), np.ones(2 * len(r))) for r in (apart, together))
    both = (S[:, None] + W[None]).reshape(-1, 2)
    return math.floor(ConvexHull(both).volume / ConvexHull(S).volume + 1e-9)


def _room(sep: Separation, limits: tuple[Ceiling, ...], scenario: Scenario) -> float:
    """The longest span of offsets that U and control leave."""
    B = np.array(scenario.B)
    unit = line_offsets(sep, 2) / np.ptp(line_offsets(sep, 2))  # a span of 1
    spans = [input_length(scenario.control.inputs)]
    for limit in limits:
        along = half_width(unit @ B.T, np.array(limit.vector))
        if along > 0:
            spans.append(max(0.0, limit.room) / along)
    return min(spans)
