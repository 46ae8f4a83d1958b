"""What any tap leaves who watches through noise: closed forms, enumeration, taps, and pitfalls."""

import math

import numpy as np
import pytest
from scipy.stats import norm

from runtime.scenario_file import scenario_of
from studies.bound.coins import Coin, largest_gain
from studies.bound.loop import LinearLoop
from studies.bound.taps import block_left, response
from studies.signalling import changed

HALF_WIDTH = 0.12
D = np.array([0.1, 0.1])


@pytest.fixture(scope="module")
def four() -> LinearLoop:
    return LinearLoop.of(scenario_of("packed"))


@pytest.fixture(scope="module")
def two() -> LinearLoop:
    return LinearLoop.of(changed("packed", secrecy={"alpha": 3.01, "candidates": 2}))


# --- one coin ------------------------------------------------------------------------------------


@pytest.mark.parametrize("a", [0.1, 0.5, 1.07, 2.0, 4.0])
def test_one_coin_of_two_is_the_binary_gaussian_channel(a: float) -> None:
    coin = Coin(np.array([[-a], [a]]), 1.0)
    assert coin.guess == pytest.approx(norm.cdf(a), rel=1e-12)
    y = np.linspace(-a - 12, a + 12, 200_001)
    density = norm.pdf(y - a)
    expected = np.trapezoid(density * np.log2(1 + np.exp(-2 * a * y)), y)
    assert coin.bits == pytest.approx(float(expected), abs=1e-9)
    # s = 2 by hand
    both = 0.5 * np.stack([norm.pdf(y - a), norm.pdf(y + a)])
    collision = -2 * math.log2(np.trapezoid(np.sqrt((both**2).sum(axis=0)), y))
    assert coin.renyi(2.0) == pytest.approx(collision, abs=1e-9)


# --- the loop ------------------------------------------------------------------------------------


def test_the_gain_of_one_state_in_closed_form() -> None:
    for pole in (0.9, -0.5, 0.0):
        gain = largest_gain(np.array([[pole]]), np.array([[2.0]]), np.array([[3.0]]))
        assert gain == pytest.approx(6 / (1 - abs(pole)), rel=1e-7)
        assert gain >= 6 / (1 - abs(pole))


def test_the_gain_is_above_a_narrow_peak_that_a_grid_misses() -> None:
    r, angle = 1 - 1e-6, 1.2345
    F = r * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    B, C = np.array([[1.0], [0.0]]), np.eye(2)
    at = np.exp(1j * angle)
    peak = float(np.linalg.norm(C @ np.linalg.solve(at * np.eye(2) - F, B), 2))
    assert peak > 1e5
    assert largest_gain(F, B, C) >= peak * (1 - 1e-9)


def test_the_response_of_any_block_is_below_the_gain(four: LinearLoop) -> None:
    """S'S <= g^2: the step on which the theorem stands, on blocks of 1 to 200 coins."""
    F = four.A + four.B @ four.K
    gain = largest_gain(F, four.B, np.eye(2))
    norms = [np.linalg.norm(response(F, four.B, n + 50, n), 2) for n in (1, 2, 10, 50, 200)]
    assert norms == sorted(norms)
    assert norms[-1] <= gain
    assert norms[-1] > 0.99 * gain


@pytest.mark.parametrize(
    ("ratio", "bits", "key"),
    [
        (0.5, 0.09, 0), (0.75, 0.41, 206), (1, 0.71, 475), (1.5, 1.12, 875), (2, 1.37, 1130),
        (3, 1.65, 1427), (4, 1.78, 1585),
    ],
)  # fmt: skip
def test_true_bits_a_step_and_keys_of_a_thousand_coins(
    four: LinearLoop, ratio: float, bits: float, key: int
) -> None:
    coin = four.coin(ratio * HALF_WIDTH)
    assert coin.bits == pytest.approx(bits, abs=0.005)
    assert coin.key_bits(1000, 1e-12) == key


# --- no tap is below it --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("noise", "whole", "most", "bits", "least"),
    [(0.12, 0.2799, 0.2932, 3.861, 3.752), (0.24, 0.0580, 0.0602, 6.586, 6.549)],
)
def test_all_sequences_of_eight_coins_weighed_by_one_who_knows_d(
    two: LinearLoop, noise: float, whole: float, most: float, bits: float, least: float
) -> None:
    left = block_left(two, D, noise, 8, 20_000, 1, told=True)
    coin = two.coin(noise)
    assert coin.guess**8 == pytest.approx(most, abs=5e-5)
    assert 8 * coin.bits == pytest.approx(least, abs=5e-4)
    assert left.whole == pytest.approx(whole, abs=4 * left.whole_error + 5e-4)
    assert 8 * left.bits == pytest.approx(bits, abs=8 * 4 * left.bits_error)
    assert left.whole + 3 * left.whole_error <= coin.guess**8
    assert left.bits - 3 * left.bits_error >= coin.bits
    # and the bound is no idle one
    assert left.bits < 1.05 * coin.bits
