"""Codes over blocks of steps: the chained code's sizes reach what the volume allows."""

import math
from fractions import Fraction

import pytest

from studies.capacity import chained_keys


def test_the_chained_code_s_sizes() -> None:
    assert chained_keys(2.5, 6) == [2, 4, 9, 22, 54, 134]
    assert chained_keys(8, 4) == [7, 55, 439, 3511]
    assert math.log2(chained_keys(2.5, 40)[-1]) / 40 == pytest.approx(1.300, abs=5e-4)
    assert math.log2(chained_keys(8, 10)[-1]) / 10 == pytest.approx(2.978, abs=5e-4)
    assert chained_keys(2, 50) == chained_keys(1.5, 50) == [1] * 50


@pytest.mark.parametrize("alpha", [2.01, 2.25, 2.5, 3.0, 3.7, 8.0])
def test_the_rate_grows_to_the_volume_bound(alpha: float) -> None:
    keys = chained_keys(alpha, 1000)
    rates = [math.log2(keys[T - 1]) / T for T in (1, 10, 100, 1000)]
    assert rates == sorted(rates)
    assert rates[-1] <= math.log2(alpha)
    # K_T >= alpha K_(T-1) - 1, so it comes within the T-th part of a constant
    assert math.log2(alpha) - rates[-1] < 10 / 1000
    for T in range(1, 12):
        finite = max(1, math.ceil((alpha - 1) / 2)) ** T
        assert finite <= keys[T - 1] <= Fraction(alpha) ** T
