"""A network's table live: it takes the very steps that a simulation says."""

from pathlib import Path

import pytest

from tests.campaigns.tables import live
from tests.support.size import size

pytestmark = [pytest.mark.slow, pytest.mark.integration]


@pytest.mark.long
@pytest.mark.parametrize("name", size(["bursts", "measured"], ["losses", "bursts", "measured"]))
def test_a_live_loop_misses_every_step_that_the_table_takes(name: str, tmp_path: Path) -> None:
    """150 steps at the plant's own pace. A late machine may miss others, and is not counted.

    So what the table takes of a live run is what it takes of a simulated one, whose share is held
    to the one computed (`test_the_share_computed_is_the_share_counted`).
    """
    found = live(tmp_path, name, seed=4, steps=150, pace="realtime")
    assert found["made_though_taken"] == 0
    assert found["taken"] > 5
    assert found["made"] > 30
