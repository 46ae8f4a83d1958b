"""A ghost at the sensor of `watched`, in virtual time: she is seen at once, or holds the keys."""

from pathlib import Path

import pytest

from protocol.scenario import attack_of
from runtime.run_folder import CONTROLLER_TRACE, PLANT_TRACE
from tests.support.recorded_pair import RecordedPair
from tests.support.size import size
from tests.support.traces import events_of

ONSET = 200
STEPS = 60
HEARS_ALL = "loss = 0.3", "loss = 0.0"
WITHIN = 10
"""Steps: she passes the test of each with probability 1/4, and all ten with 1e-6."""


def attacked(folder: Path, *, hears_all: bool) -> tuple[list[int], float]:
    """Steps at which there was an alarm, and how far the plant was led."""
    loop = RecordedPair(
        folder,
        name="watched",
        attack=attack_of(f"ghost@{ONSET}"),
        changes=(HEARS_ALL,) if hears_all else (),
    )
    loop.run(lambda: loop.plant.state.record.link.k >= ONSET + STEPS)
    loop.stop()
    alarms = [e["k"] for e in events_of(folder / CONTROLLER_TRACE, "alarm")]
    off = [
        max(abs(a - b) for a, b in zip(e["true_x_next"], e["x_next"], strict=True))
        for e in events_of(folder / PLANT_TRACE, "transition")
        if "true_x_next" in e
    ]
    return alarms, max(off, default=0.0)


@pytest.mark.long
@pytest.mark.parametrize("run", range(size(2, 30)))
def test_she_is_seen_within_ten_steps_where_the_keys_are_secret(run: int, tmp_path: Path) -> None:
    alarms, _ = attacked(tmp_path, hears_all=False)
    assert alarms
    assert ONSET - 1 <= alarms[0] < ONSET + WITHIN, run


@pytest.mark.long
@pytest.mark.parametrize("run", range(size(2, 30)))
def test_she_is_never_seen_where_she_hears_all(run: int, tmp_path: Path) -> None:
    alarms, off = attacked(tmp_path, hears_all=True)
    assert not alarms, run
    assert off > 1.0
