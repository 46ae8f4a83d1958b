"""The paper's rule has no limit: any number of keys at any alpha above 1, none of them secret."""

import itertools

import numpy as np
import pytest

from controller_service.sets.terminal import feedback_gain
from protocol.agreement import INSIDE
from protocol.scenario import ConvexSet
from runtime.scenario_file import scenario_of
from studies.capacity.void import VoidKeying, public_key

SIZES = [(1.01, 16), (1.05, 24), (1.1, 64), (1.2, 100)]


def judge(
    keying: VoidKeying, applied: float, d: np.ndarray, x_next: np.ndarray
) -> tuple[set[int], set[int]]:
    """Keys that are possible for the defender, and for her."""
    g = keying.gauges(applied, d)
    labels = keying.labels(g, x_next)
    return set(labels[g <= INSIDE].tolist()), set(labels[g <= keying.alpha].tolist())


@pytest.mark.parametrize(("alpha", "keys"), SIZES)
def test_every_transition_agrees_and_every_key_is_possible_for_her(alpha: float, keys: int) -> None:
    """The paper's plant in closed loop: d at corners, at edges and inside, inputs at either end."""
    scenario = scenario_of("packed")
    A, B = np.array(scenario.A), np.array(scenario.B)[:, 0]
    K = feedback_gain(scenario)[0]
    keying = VoidKeying.of(B, scenario.defender.disturbance, alpha, keys)
    rng = np.random.default_rng(3)
    ends = [0, 1, len(keying.offsets) // 2, -2, -1]
    corners = [np.array(c) * 0.12 for c in itertools.product((-1, 0, 1), repeat=2)]
    cases = [(float(keying.offsets[i]), d) for i in ends for d in corners]
    cases += [(float(rng.choice(keying.offsets)), rng.uniform(-0.12, 0.12, 2)) for _ in range(200)]
    x = np.array([0.3, -0.2])
    agreed = []
    for applied, d in cases:
        x_next = A @ x + B * (K @ x + applied) + d
        hers, theirs = judge(keying, applied, d, x_next)[::-1]
        assert len(theirs) == 1
        assert hers == set(range(keys))
        (key,) = theirs
        assert key == public_key(x_next, keys)  # whoever hears x(k+1) has it: no bit is secret
        agreed.append(key)
        x = x_next
    assert len(set(agreed)) > keys // 2  # and it is no constant


@pytest.mark.parametrize(("alpha", "keys", "b"), [(1.0, 4, 0.5), (1.1, 1, 0.5), (1.1, 4, 0.0)])
def test_what_cannot_be_is_refused(alpha: float, keys: int, b: float) -> None:
    with pytest.raises(ValueError, match=r"got|plant\.B"):
        VoidKeying.of((0.0, b), ConvexSet(half_widths=(0.12, 0.12)), alpha, keys)
