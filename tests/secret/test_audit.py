"""What she holds: nothing at the proper length, and what linear algebra predicts beyond it.

Each control breaks one rule on purpose, beside the proper one that holds.
"""

import random

import pytest

from protocol.secret.bound import Assumption
from studies.keys import CONTROLS
from tap_service.eavesdroppers.key_solver import bits_held
from tap_service.inference.miss_rate import Misses


@pytest.mark.parametrize("control", CONTROLS)
def test_a_broken_rule_gives_bits_away_and_the_rule_none(control: str) -> None:
    """Those of docs/keys.md; among them a jammer, where the rule forgets what the link lost."""
    blocks = [CONTROLS[control](random.Random(seed)) for seed in range(40)]
    assert any(block.broken for block in blocks)
    assert not any(block.kept for block in blocks)


@pytest.mark.parametrize(
    ("true", "claimed", "breached"), [(0.3, 0.3, 0), (0.3, 0.5, 20), (0.0, 0.3, 20), (0.45, 0.5, 0)]
)
def test_a_claim_above_the_truth_breaks(true: float, claimed: float, breached: int) -> None:
    rows = Assumption(claimed).rows(256, 256, 512)
    generator = random.Random(1)
    found = 0
    everything = Misses(claimed)
    for _ in range(20):
        misses = [generator.random() < true for _ in range(512)]
        for missed in misses:
            everything.add(missed=missed)
        found += bits_held(rows, sum(misses)) > 0
    assert found == breached or found >= breached - 1 >= 18
    # the audit says so even where the bound's slack hides it
    assert everything.judge().refuted == (true < claimed)
