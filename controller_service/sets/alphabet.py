"""Packed alphabets: how many inputs stay apart, and together, whatever the disturbance does.

Two candidates u and u' put their centres B (u - u') apart. The defender can tell them for every d
in D_c when that difference is outside D_c - D_c. Both are possible for the eavesdropper for every
d in D_c when it is inside alpha D_c less D_c, which is (alpha - 1) D_c, and its mirror image. An
alphabet is a set of offsets whose differences all do both: then every transition agrees.

For one input that is a progression. In the paper's example D_c - D_c reaches sigma = 0.492 along b,
(alpha - 1) D_c reaches omega = 1.722 at alpha = 8, and 1 + floor(1.722 / 0.492) = 4 inputs fit.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from controller_service.sets.grid_alphabet import plane_offsets, plane_size
from controller_service.sets.separation import APART, TOGETHER, AlphabetError, Separation
from controller_service.sets.terminal import set_corners
from protocol.arrays import Array
from protocol.scenario import ConvexSet
from protocol.scenario.laws import CERTAIN

ROUNDING = 1e-12
"""U' is smaller by this fraction, so that v + p rounds to an input in U."""


@dataclass(frozen=True, eq=False)
class Alphabet:
    """The offsets of a packed alphabet.

    Parameters
    ----------
    offsets : array, shape (M, m)
        Candidate r is v + ``offsets[r]``; centred.
    spacing : float
        In half-lengths of D_c: from 2 every transition agrees, below it is a bet.
    """

    offsets: Array
    spacing: float

    @property
    def size(self) -> int:
        """M."""
        return len(self.offsets)

    @property
    def reach(self) -> Array:
        """The largest offset of each input, shape (m,)."""
        out: Array = np.abs(self.offsets).max(axis=0)
        return out


def line_size(sep: Separation, alpha: float, length: float = math.inf) -> int:
    """M, the most inputs of one input's alphabet.

    Exactly max(1, ceil(min(omega, L) / sigma)); this one keeps clear of rounding, and so is one
    less where omega / sigma is an integer or above one by less than a millionth.

    Parameters
    ----------
    sep : Separation
    alpha : float
        D_e = alpha D_c.
    length : float
        L, the length of the interval that the inputs must lie in.
    """
    if sep.sigma() == math.inf:
        return 1
    span = min(sep.omega(alpha) * (1 - TOGETHER), length)
    return 1 + math.floor(span / (sep.sigma() * (1 + APART)))


def line_offsets(sep: Separation, size: int) -> Array:
    """The progression of ``size`` offsets around 0, shape (size, 1); the closest that is certain.

    Raises
    ------
    AlphabetError
        When the input moves nothing.
    """
    sigma = sep.sigma()
    if sigma == math.inf:
        raise AlphabetError("plant.B: the input moves no state, expected one that does")
    step = sigma * (1 + APART)
    return np.array((np.arange(size) - (size - 1) / 2)[:, None] * step)


def smaller_inputs(inputs: ConvexSet, offsets: Array) -> ConvexSet | None:
    """U less the hull of the offsets, None when the origin is not inside; a box stays a box."""
    if not offsets.any():
        return inputs
    if inputs.half_widths is not None:
        widths = (np.array(inputs.half_widths) - np.abs(offsets).max(axis=0)) * (1 - ROUNDING)
        return ConvexSet(half_widths=tuple(widths.tolist())) if (widths > 0).all() else None
    H, h = (np.array(a) for a in inputs.rows())
    left = (h - (offsets @ H.T).max(axis=0)) * (1 - ROUNDING)
    if not (left > 0).all():
        return None
    return ConvexSet(H=tuple(map(tuple, H.tolist())), h=tuple(left.tolist()))


def larger_disturbance(disturbance: ConvexSet, B: ArrayLike, offsets: Array) -> ConvexSet:
    """D' = D_c + B conv P, by the hull of sums of corners; D_c itself for one candidate at 0."""
    push = offsets @ np.asarray(B, dtype=float).T
    if not push.any():
        return disturbance
    points = (set_corners(disturbance)[:, None] + push[None]).reshape(-1, disturbance.dimension)
    if disturbance.dimension == 1:
        low, high = float(points.min()), float(points.max())
        return ConvexSet(H=((1.0,), (-1.0,)), h=(high, -low))
    from scipy.spatial import ConvexHull

    normals = ConvexHull(points).equations[:, :-1]
    # A facet of many corners comes in simplices, each with the normal to the last digits.
    _, first = np.unique(np.round(normals, 12), axis=0, return_index=True)
    H = normals[first]
    h = (points @ H.T).max(axis=0)
    return ConvexSet(H=tuple(map(tuple, H.tolist())), h=tuple(h.tolist()))


def half_width(points: Array, w: Array) -> float:
    """Half the width of the hull of points, shape (corners, n), in the direction w."""
    return 0.5 * float(np.ptp(points @ w))


@dataclass(frozen=True)
class Ceiling:
    """What control itself allows along one unstable or integrating mode of A.

    A bounded invariant set needs ``magnitude * (disturbance + alphabet) <= inputs - alphabet``,
    all half-widths along the mode's left eigenvector.
    """

    magnitude: float
    disturbance: float
    inputs: float
    vector: tuple[float, ...]

    def holds(self, alphabet: float) -> bool:
        """Whether an alphabet of this half-width leaves room for control."""
        return self.magnitude * (self.disturbance + alphabet) <= self.inputs - alphabet

    @property
    def room(self) -> float:
        """The largest half-width of an alphabet along the mode."""
        return (self.inputs - self.magnitude * self.disturbance) / (1 + self.magnitude)


def ceilings(
    A: ArrayLike, B: ArrayLike, disturbance: ConvexSet, inputs: ConvexSet
) -> tuple[Ceiling, ...]:
    """One for each real eigenvalue of A of magnitude 1 or more."""
    M, G = np.asarray(A, dtype=float), np.asarray(B, dtype=float)
    values, vectors = np.linalg.eig(M.T)
    D, BU = set_corners(disturbance), set_corners(inputs) @ G.T
    out = []
    for value, vector in zip(values, vectors.T, strict=True):
        # Equal eigenvalues come out apart by the root of a rounding.
        if abs(value.imag) > 1e-7 or not abs(value) >= 1 - 1e-7:
            continue
        w = vector.real
        if not (np.abs(w).max() > 0 and np.abs(vector.imag).max() <= 1e-6 * np.abs(w).max()):
            continue
        magnitude = max(1.0, abs(float(value.real)))
        out.append(Ceiling(magnitude, half_width(D, w), half_width(BU, w), tuple(w.tolist())))
    return tuple(out)


def control_allows(limits: Sequence[Ceiling], B: ArrayLike, offsets: Array) -> bool:
    """Whether an alphabet is below every ceiling."""
    BP = offsets @ np.asarray(B, dtype=float).T
    return all(limit.holds(half_width(BP, np.array(limit.vector))) for limit in limits)


def choose_alphabet(
    B: ArrayLike,
    disturbance: ConvexSet,
    inputs: ConvexSet,
    *,
    alpha: float,
    size: int,
    spacing: float = CERTAIN,
    shape: ConvexSet | None = None,
    tested: ConvexSet | None = None,
) -> Alphabet:
    """The alphabet of ``size`` candidates for one or two inputs; D_e = alpha ``shape``, or D_c.

    ``tested`` is W, where sensors are noisy.

    Raises
    ------
    AlphabetError
        When no such alphabet is certain, or U has no room; it names the most that fit. Below a
        spacing of 2 the spread is not held against alpha: that is the bet.
    """
    sep = Separation.of(B, disturbance, shape, tested)
    if sep.inputs > 2:
        raise AlphabetError(f"plant.B: got {sep.inputs} inputs, expected 1 or 2 for packed")
    spaced = sep.spaced(spacing)
    most = largest_certain(spaced, alpha)
    if spacing >= CERTAIN and size > most:
        raise AlphabetError(
            f"secrecy.candidates: got {size}, expected at most {most}: no more inputs stay apart "
            f"for the defender and together within D_e at alpha = {alpha:g}"
        )

    def offsets(count: int) -> Array:
        if sep.inputs == 1:
            return line_offsets(spaced, count)
        # A bet draws an alphabet of a larger alpha together.
        wide = float(sep.taken.max()) * (3 + 2 * math.sqrt(count))
        return plane_offsets(spaced, alpha if count <= most else wide, count)

    chosen = offsets(size)
    if smaller_inputs(inputs, chosen) is None:
        fits = size - 1
        while fits > 1 and smaller_inputs(inputs, offsets(fits)) is None:
            fits -= 1
        raise AlphabetError(
            f"secrecy.candidates: got {size}, expected at most {fits}: control.inputs has no room "
            f"for offsets up to {np.abs(chosen).max():.6g}"
        )
    return Alphabet(chosen, spacing)


def largest_certain(sep: Separation, alpha: float) -> int:
    """The most candidates of which every transition agrees; one or two inputs."""
    return line_size(sep, alpha) if sep.inputs == 1 else plane_size(sep, alpha)
