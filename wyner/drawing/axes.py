"""Drawings on axes of the user's own: data come as arrays, the rest of the figure is theirs."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes

from protocol.arrays import Array


def closed(points: Array) -> Array:
    """A convex ring in order of angle about its middle, the first point again at the end."""
    plane = points[:, :2]
    middle = plane.mean(axis=0)
    order = np.arctan2(plane[:, 1] - middle[1], plane[:, 0] - middle[0]).argsort()
    return np.concatenate([plane[order], plane[order[:1]]])


def draw_sets(axes: Axes, sets: Mapping[int, Array], x: Array | None = None) -> None:
    """Outlines of sets T_i, corners of shape (corners, 2), and trajectories (R, steps + 1, 2).

    Raises
    ------
    ValueError
        When the sets are not in the plane.
    """
    for i, points in sets.items():
        if points.shape[1] != 2:
            raise ValueError(f"T_{i}: got {points.shape[1]} states, expected 2 to draw")
        ring = closed(points)
        axes.plot(ring[:, 0], ring[:, 1], color="0.6", lw=0.8)
        top = ring[ring[:, 1].argmax()]
        axes.annotate(f"$T_{{{i}}}$", (top[0], top[1]), color="0.3", fontsize="small")
    for track in () if x is None else x:
        axes.plot(track[:, 0], track[:, 1], marker=".", ms=3, lw=0.8)
    axes.set_xlabel("$x_1$")
    axes.set_ylabel("$x_2$")


def draw_agreement(axes: Axes, predictions: Array, x_next: Array, D_c: Array, D_e: Array) -> None:
    """Reach^c and Reach^e about each candidate's centre, and x(k+1).

    Parameters
    ----------
    axes : Axes
    predictions : array, shape (M, n)
    x_next : array, shape (n,)
    D_c, D_e : array, shape (corners, n)
    """
    if D_c.shape[1] < 2:
        raise ValueError("got 1 state, expected at least 2 to draw")
    rings = hull(D_c[:, :2]), hull(D_e[:, :2])
    for i, c in enumerate(predictions):
        (line,) = axes.plot(c[0], c[1], marker="+", ms=8, ls="none")
        for ring, style, who in zip(rings, ("-", "--"), "ce", strict=True):
            at = c[:2] + ring
            label = f"Reach$^{who}(x, u_{i})$"
            axes.plot(at[:, 0], at[:, 1], style, color=line.get_color(), lw=1, label=label)
    axes.plot(x_next[0], x_next[1], "k*", ms=9, label="x(k+1)")
    axes.set_xlabel("$x_1$")
    axes.set_ylabel("$x_2$")
    axes.legend(fontsize="small")


def hull(points: Array) -> Array:
    """The outline of the points' shadow in the plane, closed."""
    from scipy.spatial import ConvexHull

    return closed(points[ConvexHull(points).vertices])
