"""A run of `sealed` on files: it passes, and what is changed in its positions and pads is seen."""

from pathlib import Path

import pytest

from runtime.run_folder import CAPTURE, CONTROLLER_TRACE, PLANT_TRACE
from tests.runs.check.mutants import unnoticed
from tests.support.checked_runs import failed
from tests.support.recorded_pair import RecordedPair, read_lines

TEXT = b"Meet me at nine"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "sealed"
    loop = RecordedPair(folder, TEXT, name="sealed")
    loop.run(lambda: loop.delivered == 1)
    assert loop.received == [TEXT]
    loop.stop()
    return folder


def test_it_passes_and_a_transition_carries_where_it_has_digits(run: Path) -> None:
    assert failed(run) == set()
    steps = [line for line in read_lines(run / PLANT_TRACE) if line["event"] == "transition"]
    assert [s for s in steps if s.get("keyed")] == [s for s in steps if s["message_symbol"] >= 0]
    assert sum(s.get("keyed", False) for s in steps) >= 4 * len(TEXT)


def test_a_position_or_a_digit_that_is_otherwise_is_seen(run: Path) -> None:
    """Of transitions that carry and of others; and of offers in the capture."""
    for trace in (PLANT_TRACE, CONTROLLER_TRACE):
        assert unnoticed(run, trace, {"transition": ("digits", "keyed")}) == []
    assert unnoticed(run, CAPTURE, {"offer": ("stream_block", "stream_at")}) == []
