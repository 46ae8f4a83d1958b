"""Codes over blocks of steps: the chained code reaches what the volume allows, and no code more."""

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest

from studies.capacity.blocks import (
    ChainedCode,
    chained_bits,
    chained_keys,
    finite_keys,
    most_keys,
)


def test_the_chained_code_s_sizes() -> None:
    assert chained_keys(2.5, 6) == [2, 4, 9, 22, 54, 134]
    assert chained_bits(2.5, 40) == pytest.approx(1.300, abs=5e-4)
    assert math.log2(2.5) == pytest.approx(1.322, abs=5e-4)
    assert chained_bits(8, 10) == pytest.approx(2.978, abs=5e-4)
    assert chained_keys(2, 50) == chained_keys(1.5, 50) == [1] * 50


@pytest.mark.parametrize("alpha", [2.01, 2.25, 2.5, 3.0, 3.7, 8.0])
def test_the_rate_grows_to_the_volume_bound(alpha: float) -> None:
    rates = [chained_bits(alpha, T) for T in (1, 10, 100, 1000)]
    assert rates == sorted(rates)
    assert rates[-1] <= math.log2(alpha)
    # K_T >= alpha K_(T-1) - 1, so it comes within the T-th part of a constant
    assert math.log2(alpha) - rates[-1] < 10 / 1000
    for T in range(1, 12):
        assert finite_keys(alpha, T) <= chained_keys(alpha, T)[-1] <= most_keys(alpha, T)


@pytest.mark.parametrize(("alpha", "steps"), [("5/2", 3), ("9/4", 3), ("3", 2), ("41/20", 4)])
def test_every_block_agrees_on_the_chained_code(alpha: str, steps: int) -> None:
    """In rationals: d at its ends, in the middle and at random, far from the offers' ends."""
    rng = np.random.default_rng(steps)
    code = ChainedCode.of(Fraction(alpha), steps)
    assert code.gap > 2
    q = code.keys[-1]
    blocks = list(code.paths(3))
    choice = rng.permutation(len(blocks))[:60]
    for which in choice:
        path, key = blocks[which]
        applied = [code.place(t, index) for t, index in enumerate(path, start=1)]
        ends = (Fraction(-1), Fraction(0), Fraction(1))
        ds = [*itertools.product(ends, repeat=steps)]
        ds += [tuple(Fraction(int(v), 97) for v in rng.integers(-97, 98, steps)) for _ in range(5)]
        for d in ds:
            y = tuple(p + Fraction(v) for p, v in zip(applied, d, strict=True))
            theirs = code.possible(y, Fraction(1))[-1]
            hers = code.possible(y, code.alpha)[-1]
            assert theirs == {key: 1}  # one path remains, and so one key
            assert set(hers) == set(range(q))


def test_a_gap_of_two_or_a_key_more_is_refused_by_the_same_check() -> None:
    code = ChainedCode.of(Fraction(5, 2), 2)
    close = ChainedCode(code.alpha, Fraction(2), code.keys)
    y = (Fraction(1), Fraction(0))  # halfway between the inputs 0 and 2 of step 1
    assert len(close.possible(y, Fraction(1))[0]) == 2
    more = ChainedCode(code.alpha, code.gap, (1, 2, 5))
    lacking = [
        v
        for v in range(-50, 50)
        if len(more.possible((Fraction(0), Fraction(v, 10)), code.alpha)[-1]) < 5
    ]
    assert lacking
