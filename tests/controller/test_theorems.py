"""What would refute the theorems of docs/findings.md: exhaustive searches on small cases."""

import itertools
import math

import numpy as np
import pytest

STEPS = np.linspace(-1, 1, 9)
"""d in half-lengths of D_c, its ends included."""


def certain(points: tuple[float, ...], keys: tuple[int, ...], alpha: float) -> bool:
    """Whether every transition agrees on the applied point's key, for every d."""
    y = np.array(points)[:, None] + STEPS
    distance = np.abs(y[:, :, None] - np.array(points))
    colour = np.array(keys)
    for key in set(keys):
        nearest = distance[:, :, colour == key].min(axis=2)
        if not (nearest <= alpha).all():
            return False
        if not (nearest[colour != key] > 1).all():
            return False
    return True


@pytest.mark.parametrize("alpha", [2.9, 3.5, 4.9, 5.5])
def test_no_keying_of_the_applied_input_beats_the_progression(alpha: float) -> None:
    """Every alphabet of up to four points on a grid, with every colouring."""
    best = 1
    grid = [0.75 * k for k in range(1, 12)]
    for count in range(1, 4):
        for rest in itertools.combinations(grid, count):
            for keys in itertools.product(range(4), repeat=count):
                colours = (0, *keys)
                q = len(set(colours))
                if q > best and certain((0.0, *rest), colours, alpha):
                    best = q
    assert best == max(1, math.ceil((alpha - 1) / 2))


@pytest.mark.parametrize("alpha", [2.2, 2.9, 3.4, 4.1, 5.7])
def test_long_alphabets_agree_but_at_their_ends(alpha: float) -> None:
    spacing = 2 + 1e-6
    for q in range(2, 8):
        points = spacing * np.arange(-30, 31)
        colour = np.arange(-30, 31) % q
        interior = np.abs(points) < 10
        distance = np.abs((points[interior][:, None] + STEPS)[:, :, None] - points)
        possible = all(
            (distance[:, :, colour == key].min(axis=2) <= alpha).all() for key in range(q)
        )
        assert possible == (q <= math.ceil(alpha) - 1)


def test_wider_in_a_direction_that_no_input_moves() -> None:
    """D_e is strictly larger than D_c, and no key is ever agreed: b = (0, 1)."""
    rng = np.random.default_rng(1)
    D_c = np.array([1.0, 1.0])
    b = np.array([0.0, 1.0])
    d = rng.uniform(-1, 1, (50_000, 2)) * D_c
    moved = d + rng.uniform(-4, 4, (50_000, 1)) * b  # x+ from the other candidate's prediction

    def agreements(D_e: np.ndarray) -> int:
        possible_for_her = (np.abs(moved) <= D_e).all(axis=1)
        possible_for_the_defender = (np.abs(moved) <= D_c).all(axis=1)
        return int((possible_for_her & ~possible_for_the_defender).sum())

    assert agreements(np.array([8.0, 1.0])) == 0
    assert agreements(np.array([1.0, 8.0])) > 0
