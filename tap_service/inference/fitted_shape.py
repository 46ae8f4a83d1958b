"""In which shape to tell candidates apart: that of D_e, or the one that the disturbance shows.

What was applied left its disturbance in the set that the defender tests by. Where D_e is a multiple
of that set its own shape orders the candidates rightly. It is none where D_e is wider in one
direction than in another, and where the plant's sensors are noisy: the set is then
W = D_c + N - A N. In both cases a coordinate that tells nothing of the input may outweigh the one
that decides.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from protocol.arrays import Array, Counts
from tap_service.capture.transcript import Transition

ENOUGH: Final = 16
"""Steps heard whole from which a shape is learned."""

OPPOSITE: Final = 1e-12
"""Sum of two rows that are one turned round."""

ROOM: Final = 1e-9
"""Over the largest gauge: rounding."""

ROUNDS: Final = 30
"""Decisions and widths in turn, at most."""

SMALLEST: Final = 1e-9
"""Of a width, relative to that of D_e."""


def fitted_widths(along: Array) -> Array:
    """Widths of the smallest set, with facets along those of D_e, that holds each step's residual.

    The search starts from the shape of D_e and from each facet alone, decides along it, takes the
    widths that the decisions leave, decides in these, and so on; the start that ends with the
    smallest volume counts. For d even over such a set that is the likeliest.

    Parameters
    ----------
    along : array, shape (steps, M, rows)
        Each candidate's residual along each facet, in units of D_e.

    Returns
    -------
    array, shape (rows,)
    """
    starts = [nearest(along)]
    starts += [np.abs(along[:, :, r]).argmin(axis=1) for r in range(along.shape[2])]
    best, least = np.ones(along.shape[2]), math.inf
    for start in starts:
        widths = settled_widths(along, start)
        volume = float(np.log(widths).sum())
        if volume < least - 1e-12:
            best, least = widths, volume
    return best


def nearest(along: Array) -> Counts:
    """The candidate of least gauge, of each step; ``along`` as in :func:`fitted_widths`."""
    found: Counts = np.maximum(0.0, along.max(axis=2)).argmin(axis=1)
    return found


def settled_widths(along: Array, choice: Counts) -> Array:
    """Widths that decisions leave which are taken in these widths, searched from ``choice`` on."""
    steps = np.arange(len(along))
    for _ in range(ROUNDS):
        widths: Array = np.maximum(SMALLEST, along[steps, choice].max(axis=0))
        again = nearest(along / widths)
        if (again == choice).all():
            break
        choice = again
    return widths


def both_ways(rows: Array, reach: Array) -> Array:
    """How far what is even over a set reaches: as far both ways, where a facet has an opposite.

    Parameters
    ----------
    rows : array, shape (rows, n)
    reach : array, shape (rows,)
        What was seen along each.
    """
    opposite = np.abs(rows[:, None] + rows).max(axis=2) < OPPOSITE
    found: Array = np.maximum(reach, np.where(opposite, reach, -np.inf).max(axis=1))
    return found


@dataclass(frozen=True)
class Shape:
    """What the candidates of a step are measured in.

    Parameters
    ----------
    rows : array, shape (rows, n)
        The gauge of v is the largest entry of ``rows @ v``; at most 1 for what D_e holds.
    told : array, shape (rows, n), optional
        The rows of D_e, where ``rows`` are others.
    """

    rows: Array
    told: Array | None = None

    def gauges(self, residuals: Array) -> Array:
        """Gauges of residuals of shape (..., M, n).

        The largest of a step is infinite where D_e does not hold all its candidates.
        """
        gauges: Array = np.maximum((residuals @ self.rows.T).max(axis=-1), 0.0)
        if self.told is None:
            return gauges
        outside = (residuals @ self.told.T).max(axis=(-2, -1)) > 1.0
        largest = gauges == gauges.max(axis=-1, keepdims=True)
        return np.where(largest & outside[..., None], np.inf, gauges)


def residuals_of(A: Array, B: Array, whole: Sequence[Transition]) -> Array:
    """x(k+1) less each candidate's prediction, of steps heard whole; shape (steps, M, n)."""
    x, after = np.array([t.x for t in whole]), np.array([t.x_next for t in whole])
    u = np.array([t.candidates for t in whole])
    return (after - x @ A.T)[:, None] - u @ B.T


def likelier_shape(
    told: Array, A: Array, B: Array, heard: Sequence[Transition], *, ties: bool = True
) -> Shape:
    """The shape that the disturbance shows, or that of D_e where it explains the steps as well.

    By the likelihoods for d even over either set, less half the logarithm of the steps for each
    width beyond the one that D_e's own shape has. Where D_e's does as well, near ties between
    candidates may still be told apart in the widths that its own decisions leave.

    Parameters
    ----------
    told : array, shape (rows, n)
        H / h of D_e.
    A, B : array
        Her model.
    heard : sequence of Transition
        Without noise; those heard whole count.
    ties : bool
        Whether near ties are told apart: not where a test leaves both out, and D_e may be a
        multiple of its set.
    """
    whole = [t for t in heard if t.whole]
    count, rows = len(whole), len(told)
    if count < ENOUGH:
        return Shape(told)
    along = residuals_of(A, B, whole) @ told.T
    scale = max(float(np.maximum(0.0, along.max(axis=2)).min(axis=1).max()), SMALLEST)
    widths = fitted_widths(along)
    widths = both_ways(told, widths)
    # each direction has two facets
    gain = 0.5 * count * (rows * math.log(scale) - float(np.log(widths).sum()))
    if gain <= 0.5 * (rows - 1) * math.log(count) + rows:
        if not ties:
            return Shape(told)
        own = nearest(along)
        widths = both_ways(told, settled_widths(along, own))
        if (nearest(along / widths) == own).all():
            return Shape(told)
    gauges = (along / widths).max(axis=2)
    possible = (along <= 1.0).all(axis=(1, 2))
    most = float(gauges[possible].max(initial=1.0)) * (1 + ROOM)
    return Shape(told / (widths[:, None] * most), told)
