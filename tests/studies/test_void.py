"""The paper's rule has no limit: any number of keys at any alpha above 1, none of them secret."""

import math

import numpy as np
import pytest


def public(x_next: float, keys: int) -> int:
    """A function of the state that everyone hears."""
    return int(x_next * 1e6) % keys


@pytest.mark.parametrize(
    ("alpha", "keys", "inputs", "length"), [(1.01, 16, 3235, 0.497), (1.2, 100, 1203, 0.592)]
)
def test_every_transition_agrees_and_every_key_is_possible_for_her(
    alpha: float, keys: int, inputs: int, length: float
) -> None:
    """One state, d and inputs in half-lengths of D_c; the inputs are v + the offsets."""
    band = alpha - 1  # beyond D_c, on either side
    spacing = (1 - 1e-6) * band / keys
    half = math.ceil((1 + band) / spacing)
    offsets = np.arange(-half, half + 1) * spacing
    assert len(offsets) == inputs
    assert np.ptp(offsets) * 0.12 / 0.4877 == pytest.approx(length, abs=1e-3)
    rng = np.random.default_rng(3)
    cases = [(offsets[i], d) for i in (0, 1, half, -2, -1) for d in (-1.0, 0.0, 1.0)]
    cases += [(rng.choice(offsets), rng.uniform(-1, 1)) for _ in range(200)]
    x, agreed = 0.3, set()
    for applied, d in cases:
        x = 0.5 * x + applied + d
        gauges = np.abs(applied + d - offsets)
        near = gauges <= 1 + 1e-9
        key = public(x, keys)
        means = np.full(len(offsets), key)
        between = np.flatnonzero(~near & (gauges <= alpha))
        means[between] = (key + 1 + np.arange(len(between)) % (keys - 1)) % keys
        assert set(means[near]) == {key}  # whoever hears x(k+1) has it: no bit is secret
        assert set(means[gauges <= alpha]) == set(range(keys))
        agreed.add(key)
    assert len(agreed) > keys // 2  # and it is no constant
