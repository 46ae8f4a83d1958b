"""Packed alphabets against rational arithmetic, brute force and published bounds."""

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from controller_service.sets.alphabet import (
    ceilings,
    choose_alphabet,
    control_allows,
    line_offsets,
    line_size,
    smaller_inputs,
)
from controller_service.sets.grid_alphabet import plane_offsets, plane_size, polygon_rows
from controller_service.sets.separation import AlphabetError, Separation
from protocol.arrays import Array
from protocol.convex import corners
from protocol.scenario import ConvexSet


def distances(sep: Separation, points: Array) -> tuple[Array, Array]:
    """Both norms of the difference of every two points, shape (points, m)."""
    v = (points[:, None] - points[None])[~np.eye(len(points), dtype=bool)]
    return np.abs(v @ sep.apart.T).max(axis=-1), np.abs(v @ sep.together.T).max(axis=-1)


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
    S, W = (corners(np.vstack([r, -r]), np.ones(2 * len(r))) for r in (apart, together))
    both = (S[:, None] + W[None]).reshape(-1, 2)
    return math.floor(ConvexHull(both).volume / ConvexHull(S).volume + 1e-9)


PAPER_B = ((0.0246,), (0.4877,))
PAPER_D = ConvexSet(half_widths=(0.12, 0.12))
PAPER_U = ConvexSet(half_widths=(6.0,))
TANK_B = ((0.400086, 0.022762), (0.01209, 0.305529), (0.0, 0.215905), (0.143777, 0.0))
TANK_D = ConvexSet(half_widths=(0.03,) * 4)


def polygon(sides: int) -> ConvexSet:
    angles = 2 * np.pi * np.arange(sides) / sides
    H = np.stack([np.cos(angles), np.sin(angles)], axis=1).round(15)
    half = H[: sides // 2]
    return ConvexSet(H=tuple(map(tuple, np.vstack([half, -half]).tolist())), h=(1.0,) * sides)


def exact_gauges(offsets: list[Fraction], alpha: Fraction) -> tuple[Fraction, Fraction]:
    """Least gauge of another candidate, and largest, over all corners of the paper's D_c."""
    b = [Fraction(row[0]) for row in PAPER_B]
    w = [Fraction(c) for c in PAPER_D.half_widths or ()]
    gauges = [
        max(abs(s * wi + bi * (p - q)) / wi for s, wi, bi in zip(signs, w, b, strict=True))
        for signs in itertools.product((-1, 1), repeat=2)
        for p, q in itertools.permutations(offsets, 2)
    ]
    return min(gauges), max(gauges)


@pytest.mark.parametrize("alpha", [3.01, 5.0, 5.01, 7.0, 8.0, 9.01, 10.0])
def test_paper_alphabet_is_certain_at_every_corner_in_rationals(alpha: float) -> None:
    sep = Separation.of(PAPER_B, PAPER_D)
    size = line_size(sep, alpha)
    assert size == math.ceil((alpha - 1) / 2)
    chosen = choose_alphabet(PAPER_B, PAPER_D, PAPER_U, alpha=alpha, size=size)
    least, largest = exact_gauges(
        [Fraction(v) for v in chosen.offsets[:, 0].tolist()], Fraction(alpha)
    )
    assert least > 1 + Fraction(1, 10**9)
    assert largest <= Fraction(alpha)
    # One more input has no place: its span would be more than D_e allows.
    assert size * sep.sigma() >= sep.omega(alpha) * (1 - 1e-8)


def test_odd_alphas_lose_a_symbol_to_the_strict_gap() -> None:
    sep = Separation.of(PAPER_B, PAPER_D)
    assert [line_size(sep, a) for a in (1.0, 3.0, 5.0, 7.0)] == [1, 1, 2, 3]
    assert [line_size(sep, a) for a in (3.01, 5.01, 7.01, 9.01)] == [2, 3, 4, 5]


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 9), st.integers(1, 60), st.integers(1, 80))
def test_largest_progression_is_the_largest_set(sigma: int, omega: int, length: int) -> None:
    """Brute force: on a line the greedy set is largest; a thousandth stands for the open gap."""
    span = min(omega, length)
    points, at = 1, sigma * 1000 + 1
    while at <= span * 1000:
        points, at = points + 1, at + sigma * 1000 + 1
    sep = Separation(np.array([[1 / sigma]]), np.array([[7 / omega]]), np.ones(1))
    assert line_size(sep, 8.0, float(length)) == points == math.ceil(Fraction(span, sigma))


def test_an_interval_that_is_not_centred() -> None:
    D = ConvexSet(H=((1.0,), (-1.0,)), h=(2.0, 1.0))
    sep = Separation.of(((0.5,),), D)
    assert sep.sigma() == pytest.approx(6.0)
    assert sep.omega(8.0) == pytest.approx(14.0)


def test_refusals_name_the_largest_that_fits() -> None:
    with pytest.raises(AlphabetError, match=r"secrecy.candidates: got 5, expected at most 4"):
        choose_alphabet(PAPER_B, PAPER_D, PAPER_U, alpha=8, size=5)
    tight = ConvexSet(half_widths=(0.4,))
    with pytest.raises(AlphabetError, match=r"got 4, expected at most 2: control.inputs"):
        choose_alphabet(PAPER_B, PAPER_D, tight, alpha=8, size=4)
    with pytest.raises(AlphabetError, match=r"moves no state"):
        line_offsets(Separation.of(((0.0,), (0.0,)), PAPER_D), 2)
    with pytest.raises(AlphabetError, match=r"along one line"):
        choose_alphabet(
            ((1, 2), (1, 2)), PAPER_D, ConvexSet(half_widths=(9.0, 9.0)), alpha=8, size=4
        )
    # A bet is not held against alpha.
    assert choose_alphabet(PAPER_B, PAPER_D, PAPER_U, alpha=4, size=3, spacing=1.5).size == 3


@pytest.mark.parametrize(("alpha", "size"), [(3.0, 1), (3.5, 4), (5.5, 9), (8.0, 16), (10.0, 25)])
def test_two_inputs_on_a_box_fill_a_grid(alpha: float, size: int) -> None:
    sep = Separation.of(TANK_B, TANK_D)
    assert plane_size(sep, alpha) == plane_bound(sep, alpha) == size
    inputs = ConvexSet(half_widths=(3.0, 3.0))
    chosen = choose_alphabet(TANK_B, TANK_D, inputs, alpha=alpha, size=size).offsets
    if size > 1:
        apart, together = distances(sep, chosen)
        assert apart.min() > 1 + 5e-7
        assert together.max() <= alpha - 1
    assert np.allclose(chosen.min(axis=0), -chosen.max(axis=0))


@pytest.mark.parametrize("shear", [((1.0, 0.0), (0.0, 1.0)), ((2.0, 0.3), (-0.4, 0.7))])
@pytest.mark.parametrize("sides", [6, 8, 12])
@pytest.mark.parametrize("t", [1.01, 1.5001, 2.01, 3.01])
def test_two_inputs_in_a_polygon_are_apart_and_together(
    sides: int, t: float, shear: tuple[tuple[float, float], ...]
) -> None:
    """No two rows decide here: the grid is not the largest alphabet, and certain all the same."""
    sep = Separation.of(shear, polygon(sides))
    size = plane_size(sep, 1 + 2 * t)
    points = plane_offsets(sep, 1 + 2 * t, size)
    apart, together = distances(sep, points)
    assert apart.min() > 1
    assert together.max() <= 2 * t
    assert (t > 1.1) * 2 <= size <= plane_bound(sep, 1 + 2 * t)


def test_smaller_inputs_keep_their_form() -> None:
    offsets = np.array([[-1.0], [1.0]])
    box = smaller_inputs(ConvexSet(half_widths=(3.0,)), offsets)
    assert box is not None
    assert box.half_widths is not None
    assert list(box.half_widths) == pytest.approx([2.0], rel=1e-11)
    rows = smaller_inputs(ConvexSet(H=((1.0,), (-1.0,)), h=(2.0, 3.0)), offsets)
    assert rows is not None
    assert rows.h is not None
    assert list(rows.h) == pytest.approx([1.0, 2.0], rel=1e-11)
    assert smaller_inputs(ConvexSet(half_widths=(1.0,)), offsets) is None


def test_control_ceiling_of_the_double_integrator() -> None:
    A, B = ((1.0, 1.0), (0.0, 1.0)), ((0.5,), (1.0,))
    D, U = ConvexSet(half_widths=(0.12, 0.12)), ConvexSet(half_widths=(1.0,))
    limits = ceilings(A, B, D, U)
    assert limits[0].room == pytest.approx(0.44)  # (1 - 0.12) / 2
    sep = Separation.of(B, D)
    assert control_allows(limits, B, line_offsets(sep, 4))
    assert not control_allows(limits, B, line_offsets(sep, 5))


def test_a_stable_plant_has_no_ceiling() -> None:
    assert ceilings(((0.5, 0.2), (0.0, 0.3)), PAPER_B, PAPER_D, PAPER_U) == ()
