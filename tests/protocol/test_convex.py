"""Polytopes: what the planar and the spatial operations must keep."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from protocol.convex import (
    SetError,
    corners,
    planar_area,
    planar_reduce,
    planar_support,
    planar_vertices,
)

SQUARE = (np.array([[1.0, 0], [-1, 0], [0, 1], [0, -1]]), np.ones(4))


@st.composite
def planar_rows(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    """Random unit rows around a square, many of them redundant, some twice."""
    count = draw(st.integers(0, 25))
    angles = draw(st.lists(st.floats(-3.14, 3.14), min_size=count, max_size=count))
    bounds = draw(st.lists(st.floats(0.5, 3.0), min_size=count, max_size=count))
    H = np.array([[np.cos(a), np.sin(a)] for a in angles]).reshape(-1, 2)
    twice = draw(st.booleans())
    H, h = np.vstack([SQUARE[0], H]), np.concatenate([SQUARE[1], bounds])
    return (np.vstack([H, H]), np.concatenate([h, h * 1.5])) if twice else (H, h)


@given(planar_rows())
@settings(max_examples=100, deadline=None)
def test_area_and_support_agree_with_qhull(rows: tuple[np.ndarray, np.ndarray]) -> None:
    p = planar_reduce(*rows)
    V = planar_vertices(p)
    assert planar_area(p) == pytest.approx(ConvexHull(V).volume, rel=1e-9)
    for angle in np.linspace(-3, 3, 13):
        d = np.array([np.cos(angle), np.sin(angle)])
        assert planar_support(p, d[None])[0] == pytest.approx(float((V @ d).max()), rel=1e-7)


def test_corners_of_a_box_in_each_dimension() -> None:
    for n in range(1, 5):
        H = np.vstack([np.eye(n), -np.eye(n)])
        V = corners(H, np.arange(1.0, 2 * n + 1))
        assert {tuple(np.round(v, 9)) for v in V} == {
            tuple(v)
            for v in np.stack(
                np.meshgrid(*[(-(n + 1.0 + k), 1.0 + k) for k in range(n)]), -1
            ).reshape(-1, n)
        }


@pytest.mark.parametrize(
    ("H", "h"),
    [
        ([[1.0, 0], [0, 1], [-1, 0]], [1, 1, 1]),
        ([[1.0, 0], [-1, 0], [0, 1], [0, -1]], [1, 1, 0, 1]),
    ],
)
def test_unbounded_and_flat_sets_are_refused(H: list[list[float]], h: list[float]) -> None:
    with pytest.raises(SetError):
        planar_reduce(np.array(H), np.array(h, dtype=float))


def test_rows_a_hair_apart_are_told_apart() -> None:
    # A fan of facets 1e-7 rad apart on a circle of radius 1e7: edges of length 1, all genuine.
    angles = 0.3 + 1e-7 * np.arange(40)
    fan = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    H = np.vstack([fan, SQUARE[0]])
    h = np.concatenate([np.full(40, 1e7), np.full(4, 1.2e7)])
    assert planar_reduce(H, h).facets == 44
    # Move one facet out beyond its neighbours' corner and it must go: exactly decided.
    k = 20
    a, b, c = ([Fraction(v) for v in H[j]] for j in (k - 1, k, k + 1))

    def cross(p: list[Fraction], q: list[Fraction]) -> Fraction:
        return p[0] * q[1] - p[1] * q[0]

    limit = (cross(b, c) + cross(a, b)) * Fraction(1e7) / cross(a, c)
    nearest = float(limit)
    below, above = np.nextafter(nearest, 0), np.nextafter(nearest, np.inf)
    assert Fraction(below) < limit < Fraction(above)
    for bound, kept in ((below, 44), (above, 43)):
        h[k] = bound
        assert planar_reduce(H, h).facets == kept
