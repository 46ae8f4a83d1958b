"""Polytopes: what the planar and the spatial operations must keep."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from protocol.convex import (
    Polytope,
    SetError,
    corners,
    planar_area,
    planar_reduce,
    planar_support,
    planar_vertices,
    spatial_add_polygon,
    spatial_add_segments,
    spatial_faces,
    spatial_reduce,
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
@settings(max_examples=200, deadline=None)
def test_reducing_keeps_the_set(rows: tuple[np.ndarray, np.ndarray]) -> None:
    H, h = rows
    p = planar_reduce(H, h)
    V = planar_vertices(p)
    # Nothing that the dropped rows cut off is left, and every kept row is one of the given.
    assert (h + 1e-9 >= V @ H.T).all()
    given_rows = {(*row, bound) for row, bound in zip(H.tolist(), h.tolist(), strict=True)}
    assert {(*r, b) for r, b in zip(p.H.tolist(), p.h.tolist(), strict=True)} <= given_rows


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


@given(st.integers(3, 4), st.integers(0, 1000))
@settings(max_examples=25, deadline=None)
def test_adding_a_segment_is_the_hull_of_both_shifts(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    H = np.vstack([np.eye(n), -np.eye(n), rng.normal(size=(6, n))])
    p, V = spatial_reduce(Polytope.from_rows(H, rng.uniform(0.5, 1.5, len(H))))
    b = rng.normal(size=n)
    q = spatial_add_segments(*spatial_faces(p)[:2], [(b, -0.7, 0.9)])
    hull = ConvexHull(np.vstack([V - 0.7 * b, V + 0.9 * b]))
    # The same set: equal volume, and the hull's points satisfy every row.
    assert (hull.points @ q.H.T <= q.h + 1e-9).all()
    assert ConvexHull(spatial_reduce(q)[1]).volume == pytest.approx(hull.volume, rel=1e-9)


@given(st.integers(3, 4), st.integers(0, 1000))
@settings(max_examples=15, deadline=None)
def test_adding_a_polygon_is_the_hull_of_all_sums(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    H = np.vstack([np.eye(n), -np.eye(n), rng.normal(size=(6, n))])
    p, W = spatial_reduce(Polytope.from_rows(H, rng.uniform(0.5, 1.5, len(H))))
    V = rng.normal(size=(5, 2)) @ rng.normal(size=(2, n)) * 0.4
    V -= V.mean(axis=0)
    q = spatial_add_polygon(p, V)
    hull = ConvexHull((W[:, None] + V).reshape(-1, n))
    assert (hull.points @ q.H.T <= q.h + 1e-9).all()
    assert ConvexHull(spatial_reduce(q)[1]).volume == pytest.approx(hull.volume, rel=1e-9)


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
