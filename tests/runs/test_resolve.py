"""What a kill leaves in a trace counts once."""

from pathlib import Path

import pytest

from runtime.recording import TraceError
from runtime.run_folder import PLANT_TRACE
from tests.support.pair import SIDES
from tests.support.recorded_pair import Fault, RecordedPair
from wyner.runs.run import Run, RunError

FAULTS: dict[str, dict[int, Fault]] = {
    "none": {},
    "deaths": {5: "plant dies", 6: "plant dies", 20: "controller dies", 31: "offer lost"},
    "a lost journal": {10: "plant dies", 25: "plant forgets", 40: "offer lost", 41: "plant dies"},
    "an older copy": {10: "journal copied", 30: "journal put back", 45: "plant dies"},
}


@pytest.mark.parametrize("faults", FAULTS.values(), ids=FAULTS)
def test_each_step_counts_once_whoever_dies(tmp_path: Path, faults: dict[int, Fault]) -> None:
    run = RecordedPair(tmp_path, b"a", b"b")
    run.steps(120, faults)
    run.stop()
    plant, controller = (Run.load(tmp_path).read(side) for side in SIDES)
    made, counted = ([end.where(row) for row in end.rows] for end in (plant, controller))
    assert len(set(made)) == len(made) >= 115
    assert len(set(counted)) == len(counted) > 90
    assert set(counted) <= set(made)


def test_what_no_plant_wrote_is_one_line_that_names_the_trace(tmp_path: Path) -> None:
    run = RecordedPair(tmp_path, b"hi")
    run.steps(4)
    run.stop()
    whole = (tmp_path / PLANT_TRACE).read_bytes().splitlines(keepends=True)
    wrong = b'{"event":"transition","session":"1","k":1}\n'
    (tmp_path / PLANT_TRACE).write_bytes(b"".join([*whole[:3], wrong, *whole[3:]]))
    trace = Run.load(tmp_path).columns("plant")
    assert trace.unread.startswith("trace.jsonl line 4: a line is not as expected: ")
    assert "\n" not in trace.unread
    assert (len(trace.steps), len(trace.rows)) == (1, 4)
    with pytest.raises(TraceError, match="cannot be read"):
        Run.load(tmp_path / "plant").columns("plant")


def test_there_is_no_run_where_there_is_no_folder(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="no run here"):
        Run.load(tmp_path / "none")
