"""Bets on the law of d, against sampling, closed forms and known rates."""

import math
from typing import Literal

import numpy as np
import pytest

from controller_service.sets.alphabet import line_size
from controller_service.sets.separation import Separation
from plant_service.disturbance import disturbance
from protocol.agreement import INSIDE
from protocol.scenario import ConvexSet, Disturbance
from studies.capacity.betting import (
    DisturbanceLaw,
    best_bet,
    chances,
)

B = np.array([[0.0246], [0.4877]])
W = np.array([0.12, 0.12])
D_C = ConvexSet(half_widths=(0.12, 0.12))
UNIFORM = Disturbance(half_widths=(0.1, 0.1))

Kind = Literal["uniform", "corners", "truncated-gaussian", "gaussian", "constant", "sinusoid"]


@pytest.mark.parametrize(
    "kind", ["uniform", "corners", "truncated-gaussian", "gaussian", "constant", "sinusoid"]
)
def test_chances_are_those_of_the_plant(kind: Kind) -> None:
    spec = Disturbance(kind=kind, half_widths=(0.12, 0.1), bias=0.4, deviation=0.6)
    alpha, samples = 4.0, 4000
    sep = Separation.of(B, D_C)
    offsets = (np.arange(3) - 1.0)[:, None] * 0.72 * sep.sigma()
    centres = offsets @ B.T
    rng = np.random.default_rng(5)
    d = np.array([disturbance(spec, k, rng.random(2).tolist()) for k in range(samples)])
    expected = chances(centres, W, alpha, DisturbanceLaw.of(spec))
    for r in range(3):
        g = np.abs((d[:, None] + centres[r] - centres) / W).max(axis=2)
        others = np.delete(g, r, axis=1)
        agreed = (g[:, r] <= INSIDE) & (others > INSIDE).all(axis=1) & (others <= alpha).all(axis=1)
        error = 4 * math.sqrt(max(expected[r] * (1 - expected[r]), 1e-4) / samples)
        assert agreed.mean() == pytest.approx(expected[r], abs=error)


@pytest.mark.parametrize(
    ("alpha", "uniform", "widest"),
    [(1.5, 0.300, 0.263), (2.0, 0.600, 0.513), (4.0, 1.268, 1.077), (6.0, 1.800, 1.585)],
)
def test_best_bets_of_the_paper_plant(alpha: float, uniform: float, widest: float) -> None:
    sep = Separation.of(B, D_C)
    for spec, bits in ((UNIFORM, uniform), (Disturbance(half_widths=(0.12, 0.12)), widest)):
        law = DisturbanceLaw.of(spec)
        certain = line_size(sep, alpha)
        bet = best_bet(B[:, 0], sep.sigma(), W, alpha, law, certain=certain)
        assert bet.bits == pytest.approx(bits, abs=6e-4)


def two_uniform(alpha: float, a: float) -> float:
    """Best chance of two candidates on one input, d uniform in a D_c, 0 < a <= 1, in closed form.

    The distances that agree make a window (1, alpha] for the other candidate's gauge, of length
    alpha - 1, and d spreads it over 2 a.
    """
    return min(1.0, (alpha - 1) / (2 * a))


def test_two_candidates_in_closed_form() -> None:
    """b along one axis, so that only the window of the other candidate's gauge decides."""
    b = np.array([0.0, 1.0])
    for alpha, a in ((1.5, 0.8), (2.2, 1.0), (2.9, 0.9)):
        law = DisturbanceLaw.of(Disturbance(half_widths=(0.0, 0.12 * a)))
        bet = best_bet(b, 0.24, W, alpha, law)
        assert bet.bits == pytest.approx(two_uniform(alpha, a), abs=2e-3)
