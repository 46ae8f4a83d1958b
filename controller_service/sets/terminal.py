"""The gain K and the terminal set T_0: where the recursion of the sets starts."""

from dataclasses import dataclass

import numpy as np

from controller_service.sets.units import in_units, state_units
from controller_service.tolerances import NEARLY_PARALLEL, TERMINAL_ERROR
from protocol.arrays import Array
from protocol.convex import Polytope, corners, planar_reduce, planar_vertices
from protocol.errors import WynerError
from protocol.scenario import ConvexSet, Scenario

MOST_TERMS = 200
"""Terms of a sum after which T_0 is taken as it is, or K said to be too slow."""

MOST_FACETS = 64
"""Facets of D_c from which T_0 in the plane is made. T_0 has up to twice as many for each term."""

PRODUCTS_AT_ONCE = 4_000_000
"""Products of corners and directions held at a time (32 MB)."""

QUICK = 1e-9
"""Where A + B K makes a state smaller than this in MOST_TERMS steps, K is not what is too slow."""

UNREACHED = 1e-9
"""A mode is not moved by B where its left eigenvector meets B by less than this part of B."""


class SynthesisError(WynerError):
    """A scenario for which no sets exist; the message is one line."""


class TooSlowError(SynthesisError):
    """K brings the state back so slowly that no terminal set has room for rounding."""


class TooThinError(SynthesisError):
    """D_c is so thin beside what the plant moves by that the loop's rounding fills it."""

    def __init__(self, V: Array, moved: Array) -> None:
        j = int((np.abs(V).max(axis=0) / moved).argmin()) + 1
        super().__init__(
            f"defender.disturbance: it is too thin in x_{j} for the rounding of the loop; a "
            f"thousandth of what a step moves x_{j} by would do"
        )


@dataclass(frozen=True)
class Terminal:
    """How T_0 was made.

    Parameters
    ----------
    method : str
        ``interval`` (one state), ``rakovic`` (two), ``modal``, or ``invariant``, the maximal robust
        controlled invariant set, which needs no gain.
    order : int
        Rakovic's s, the number of terms summed; the steps of the recursion that led to an
        ``invariant`` set; 0 for the others.
    alpha : float
        Rakovic's alpha with (A + B K)^s D_c within alpha D_c; 0 for the others.
    bound : float
        No point of T_0 is farther than this from the minimal invariant set (infinity norm) of the
        D_c that is larger by the margin that was taken; of ``modal`` and ``invariant`` sets their
        radius.
    weight : float
        Factor on the regulator's stated weights of the input, where a scan was needed.
    decay : float
        The regulator was made to decay by so much a step at least, where no plain one would do.
    """

    method: str
    order: int
    alpha: float
    bound: float
    weight: float = 1.0
    decay: float = 1.0


def set_corners(s: ConvexSet) -> Array:
    """Corners of a scenario's set, shape (corners, n)."""
    if s.half_widths is not None:
        grid = np.meshgrid(*[(-w, w) for w in s.half_widths], indexing="ij")
        return np.stack([g.ravel() for g in grid], axis=1)
    return corners(*s.rows())


def input_interval(inputs: ConvexSet) -> tuple[float, float]:
    """U of one input as (u_min, u_max)."""
    H, h = inputs.rows()
    bounds = [(row[0], b / row[0]) for row, b in zip(H, h, strict=True) if row[0] != 0]
    below, above = [b for a, b in bounds if a < 0], [b for a, b in bounds if a > 0]
    if not below or not above:
        raise SynthesisError("control.inputs: the set is unbounded, expected a compact one")
    return max(below), min(above)


def feedback_gain(scenario: Scenario) -> Array:
    """K, shape (m, n): the stated gain, or the regulator's for u = K x.

    Raises
    ------
    SynthesisError
        When A + B K is not stable or no regulator exists.
    """
    A, B = np.array(scenario.A), np.array(scenario.B)
    if scenario.control.gain is not None:
        K = np.array(scenario.control.gain, dtype=float)
    else:
        weights = scenario.control.regulator
        if weights is None:
            raise SynthesisError("control.regulator: got none, expected weights, or a gain")
        K = regulator_gain(A, B, np.diag(weights.next_state), np.diag(weights.input))
    radius = float(np.abs(np.linalg.eigvals(A + B @ K)).max())
    if not radius < 1:
        raise SynthesisError(
            f"control.gain: K does not stabilise, the spectral radius of A + B K is {radius:.6g}, "
            "expected below 1"
        )
    return K


def regulator_gain(A: Array, B: Array, Q: Array, R: Array) -> Array:
    """K, shape (m, n), of the linear quadratic regulator u = K x with weights Q and R.

    Raises
    ------
    SynthesisError
        When there is none; the line names the mode that no input reaches, where that is why.
    """
    from scipy.linalg import LinAlgError, solve_discrete_are

    try:
        P = solve_discrete_are(A, B, Q, R)
    except (LinAlgError, ValueError) as error:
        why = _unreached(A, B) or str(error).rstrip(".")
        raise SynthesisError(
            f"control.regulator: no stabilising regulator exists ({why})"
        ) from None
    return np.asarray(-np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A), dtype=float)


def _unreached(A: Array, B: Array) -> str:
    """The mode of A that does not decay and that no input moves, in words; else nothing."""
    values, left = np.linalg.eig(A.T)
    moved = np.abs(left.T @ B).max(axis=1)
    still = (np.abs(values) >= 1) & (moved <= UNREACHED * np.abs(B).max())
    if not still.any():
        return ""
    j = int(still.argmax())
    return (
        f"plant.B: no input moves the mode of A with eigenvalue {_eigenvalue(values[j])}, seen "
        f"most in x_{int(np.abs(left[:, j]).argmax()) + 1}, and it does not decay"
    )


def _eigenvalue(value: complex) -> str:
    return f"{value.real:.4g}" + (f" +- {abs(value.imag):.4g}i" if value.imag else "")


def slowest_state(Ac: Array) -> int:
    """The state that takes most part in the slowest mode of A + B K, whatever its unit."""
    values, right = np.linalg.eig(Ac)
    slow = int(np.abs(values).argmax())
    left = np.linalg.pinv(right)
    return int(np.abs(right[:, slow] * left[slow]).argmax())


def faster(Ac: Array) -> str:
    """What makes K faster, in words."""
    j = slowest_state(Ac) + 1
    return (
        f"x_{j} comes back slowest: a larger regulator.next_state of x_{j}, beside the others, "
        "makes it faster (or a gain that does)"
    )


def terminal_set(Ac: Array, D: ConvexSet) -> tuple[Polytope, Terminal]:
    """An invariant set of x+ = A_c x + d, d in D, by the number of states.

    Raises
    ------
    SynthesisError
        When the route finds none; the message is one line.
    """
    V = set_corners(D)
    if len(Ac) == 1:
        return invariant_interval(float(Ac[0, 0]), V[:, 0])
    units = state_units(Ac, V)
    if units is not None:
        Ac = in_units(Ac, units)
    if len(Ac) == 2:
        p = Polytope.from_rows(*D.rows()).in_units(units)
        T0, terminal = rakovic(Ac, p)
    else:
        T0, terminal = modal(Ac, V if units is None else V / units)
    if units is None:
        return T0, terminal
    # The largest unit is 1, so that no distance is larger in the plant's units.
    return T0.in_units(1 / units), terminal


def invariant_interval(a: float, D: Array) -> tuple[Polytope, Terminal]:
    """The minimal invariant set of x+ = a x + d itself, d between the entries of D."""
    low, high = float(D.min()), float(D.max())
    if a < 0:  # every other term of D + a D + a^2 D + ... is turned round
        low, high = (low + a * high) / (1 - a * a), (high + a * low) / (1 - a * a)
    else:
        low, high = low / (1 - a), high / (1 - a)
    p = Polytope(np.array([[1.0], [-1.0]]), np.array([high, -low]))
    return p, Terminal("interval", 0, 0.0, 0.0)


def rakovic(Ac: Array, D: Polytope) -> tuple[Polytope, Terminal]:
    """F(alpha, s) = (1 - alpha)^-1 (D + A_c D + ... + A_c^(s-1) D) in the plane."""
    D_c, excess = thinned(planar_reduce(D.H, D.h))
    V = planar_vertices(D_c)
    powers = [np.eye(2)]
    reach = np.zeros(2)
    while True:
        s = len(powers)
        reach = reach + np.abs(V @ powers[-1].T).max(axis=0)
        power = Ac @ powers[-1]
        alpha = float(((V @ power.T @ D_c.H.T).max(axis=0) / D_c.h).max())
        if alpha < 1:
            # The sum's radius in the infinity norm: its support along the axes, term by term.
            radius = float(reach.max())
            bound = alpha / (1 - alpha) * radius
            if bound <= TERMINAL_ERROR * radius:
                bound += excess * radius
                break
        if s >= MOST_TERMS and alpha < 1:
            bound += excess * radius
            break  # K is slow: a set that is larger than the smallest by more than we aim at
        if s >= MOST_TERMS:
            radius = float(np.abs(np.linalg.eigvals(Ac)).max())
            if radius**MOST_TERMS < QUICK:
                raise TooThinError(V, np.abs(V @ Ac.T).max(axis=0))
            raise TooSlowError(
                "control.gain: K is too slow, the spectral radius of A + B K is "
                f"{radius:.4g}: after {s} steps a disturbance is still {alpha:.3g} times itself; "
                f"{faster(Ac)}"
            )
        powers.append(power)
    # The sum's normals are those across the terms' edges; its support is the sum of theirs.
    terms = np.stack(powers)
    edges = D_c.H @ np.array([[0.0, -1.0], [1.0, 0.0]])
    directions = (edges @ terms.transpose(0, 2, 1)).reshape(-1, 2)
    normals = np.stack([directions[:, 1], -directions[:, 0]], axis=1)
    lengths = np.sqrt((normals * normals).sum(axis=1))
    normals = normals[lengths > 0] / lengths[lengths > 0, None]
    normals = np.vstack([normals, -normals])
    reach = sum_support(V, terms, normals)
    rows = merged_directions(normals, reach / (1 - alpha))
    return planar_reduce(*rows), Terminal("rakovic", s, alpha, bound)


def thinned(p: Polytope) -> tuple[Polytope, float]:
    """A planar set with at most MOST_FACETS of a set's facets, which holds it.

    Kept are the two facets that meet at the set's corner in each of MOST_FACETS / 2 directions, so
    both sets touch there.

    Returns
    -------
    Polytope, float
        The second is the fraction by which the result may be larger: it is within 1 + it times p.
    """
    if p.facets <= MOST_FACETS:
        return p, 0.0
    turns = 2 * np.pi * np.arange(MOST_FACETS // 2) / (MOST_FACETS // 2)
    directions = np.stack([np.cos(turns), np.sin(turns)], axis=1)
    corner = (planar_vertices(p) @ directions.T).argmax(axis=0)
    keep = np.unique([corner, (corner + 1) % p.facets])
    fewer = planar_reduce(p.H[keep], p.h[keep])
    return fewer, float(((planar_vertices(fewer) @ p.H.T) / p.h).max()) - 1


def sum_support(V: Array, terms: Array, directions: Array) -> Array:
    """Support of the sum of hulls of the points V A', one for each A of ``terms``.

    Products are held for one term and a part of the directions at a time: all at once they would
    be terms * corners * directions numbers, 6 GB for a D_c of 200 facets.
    """
    out = np.zeros(len(directions))
    step = max(1, PRODUCTS_AT_ONCE // len(V))
    for start in range(0, len(directions), step):
        part = directions[start : start + step].T
        for A in terms:
            out[start : start + step] += (V @ A.T @ part).max(axis=0)
    return out


def merged_directions(H: Array, h: Array) -> tuple[Array, Array]:
    """Unit normals of the plane in order of angle, nearly equal ones as one with the least bound.

    Of late terms A_c^k D_c the normals crowd together as the ratio of the eigenvalues to the power
    k. Where they are nearer than a bound's rounding can tell, a facet between two of them seems
    redundant and is not.
    """
    angles = np.arctan2(H[:, 1], H[:, 0])
    order = angles.argsort(kind="stable")
    H, h, angles = H[order], h[order], angles[order]
    first = np.concatenate([[True], np.diff(angles) > NEARLY_PARALLEL])
    groups = np.flatnonzero(first)
    least = np.minimum.reduceat(h, groups)
    # The range of angles ends at half a turn, where a group may go on with the first one.
    if len(groups) > 1 and 2 * np.pi - angles[groups[-1]] + angles[0] <= NEARLY_PARALLEL:
        least[-1] = min(least[0], least[-1])
        groups, least = groups[1:], least[1:]
    return H[groups], least


def modal(Ac: Array, V: Array) -> tuple[Polytope, Terminal]:
    """The parallelepiped { x : abs(W x)_i <= z_i } in the modes of A_c, W A_c = M W."""
    values, vectors = np.linalg.eig(Ac)
    columns: list[Array] = []
    for value, vector in zip(values, vectors.T, strict=True):
        if value.imag == 0:
            columns.append(vector.real)
        elif value.imag > 0:
            columns += [vector.real, vector.imag]
    basis = np.stack(columns, axis=1)
    if np.linalg.cond(basis) > 1e8:
        pairs = [(abs(v - w), v, w) for i, v in enumerate(values) for w in values[:i]]
        _, v, w = min(pairs, key=lambda pair: pair[0])
        raise SynthesisError(
            f"control.gain: the eigenvalues {_eigenvalue(v)} and {_eigenvalue(w)} of A + B K "
            "nearly coincide, expected distinct ones for a terminal set in its modes"
        )
    W = np.linalg.inv(basis)
    M = np.abs(W @ Ac @ basis)
    if not np.abs(np.linalg.eigvals(M)).max() < 1 - 1e-9:
        turning = [(abs(v.real) + abs(v.imag), v) for v in values]
        size, v = max(turning, key=lambda pair: pair[0])
        raise SynthesisError(
            "control.gain: no terminal set in the modes of A + B K: that of the eigenvalue "
            f"{_eigenvalue(v)} turns faster than it decays (abs(re) + abs(im) is {size:.4g}, "
            "expected below 1)"
        )
    z = np.linalg.solve(np.eye(len(M)) - M, np.abs(V @ W.T).max(axis=0))
    p = Polytope.from_rows(np.vstack([W, -W]), np.concatenate([z, z]))
    return p, Terminal("modal", 0, 0.0, float(np.abs(corners(p.H, p.h)).max()))
