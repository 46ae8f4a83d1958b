"""What would refute theorem 2 of docs/findings.md: a linear program, a search, and closed forms."""

from statistics import NormalDist

import numpy as np
import pytest
from scipy.optimize import linprog

from controller_service.sets.terminal import feedback_gain
from runtime.scenario_file import scenario_of
from studies.attacks.study import gaussian_passes, packed
from studies.signalling import dither_price


def least(mu: float) -> float:
    """No dither of less variance, in sigma^2, is passed so seldom."""
    return (mu**-2 - 1) / 12


def gaussian(mu: float) -> float:
    """Variance of the normal dither that is passed with probability ``mu``, in sigma^2."""
    return (2 * NormalDist().inv_cdf((1 + mu) / 2)) ** -2


def least_by_program(mu: float, cells: int, reach: float) -> float:
    """The least variance over every distribution on a grid, in sigma^2: a linear program.

    Parameters
    ----------
    mu : float
        Most mass of ``cells`` neighbouring points, which is a window a little shorter than sigma.
    cells : int
        Points a sigma.
    reach : float
        How far the grid goes, in sigma.
    """
    count = 2 * round(reach * cells) + 1
    z = (np.arange(count) - count // 2) / cells
    ones = np.ones((count, count))
    windows = np.triu(ones) - np.triu(ones, cells)
    found = linprog(
        z**2,
        A_ub=windows,
        b_ub=np.full(count, mu),
        A_eq=np.vstack((np.ones(count), z)),
        b_eq=[1.0, 0.0],
        method="highs",
    )
    assert found.fun is not None, found.message
    return float(found.fun)


@pytest.mark.parametrize(("size", "variance"), [(2, 0.25), (3, 2 / 3), (4, 1.25), (5, 2.0)])
def test_no_distribution_is_cheaper(size: int, variance: float) -> None:
    """Over every distribution on a grid; the packed points attain what the theorem says."""
    found = least_by_program(1 / size, cells=16, reach=size)
    assert found == pytest.approx(variance, abs=5e-6)
    assert least(1 / size) == pytest.approx(variance, abs=1e-12)
    assert packed(size) == pytest.approx(variance, abs=1e-12)


def test_a_gaussian_needs_twice_the_variance() -> None:
    ratios = [gaussian(1 / size) / packed(size) for size in (2, 3, 4, 5, 16, 1000)]
    assert ratios == sorted(ratios, reverse=True)
    assert ratios[:4] == pytest.approx([2.198, 2.021, 1.970, 1.948], abs=1e-3)
    assert ratios[-1] == pytest.approx(6 / np.pi, abs=1e-3)
    for variance in (0.25, 1.25, 4.0):
        draws = np.random.default_rng(7).normal(0, variance**0.5, 400_000)
        assert (np.abs(draws) <= 0.5).mean() == pytest.approx(gaussian_passes(variance), abs=0.004)
    assert gaussian_passes(packed(4)) == pytest.approx(0.3453, abs=1e-4)


def test_price_is_that_of_a_simulated_loop() -> None:
    scenario = scenario_of("packed")
    A, B = np.array(scenario.A), np.array(scenario.B)
    K = feedback_gain(scenario)
    kx, ku = dither_price(A, B, K)
    assert kx == pytest.approx(0.2623, abs=1e-3)
    assert ku == pytest.approx(2.055, abs=2e-3)
    rng = np.random.default_rng(4)
    x, states, inputs = np.zeros((400, 2)), [], []
    for k in range(600):
        u = x @ K.T + rng.choice([-0.5, 0.5], (400, 1))
        x = x @ A.T + u @ B.T
        if k > 100:
            states.append((x * x).sum(axis=1).mean())
            inputs.append((u * u).mean())
    assert np.mean(states) == pytest.approx(0.25 * kx, rel=0.02)
    assert np.mean(inputs) == pytest.approx(0.25 * ku, rel=0.02)
