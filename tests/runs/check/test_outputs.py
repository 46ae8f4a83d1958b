"""``wyner check`` of a plant that is read through some outputs alone: its box, and its truth."""

import shutil
from collections.abc import Sequence
from pathlib import Path

import pytest

from protocol.box_observer import Box, BoxObserver, Observed
from protocol.vectors import Vector
from runtime.run_folder import CONTROLLER_TRACE, PLANT_TRACE
from tests.runs.check.mutants import unnoticed
from tests.support.checked_runs import failed
from tests.support.pair import SIDES
from tests.support.recorded_pair import RecordedPair, read_lines, write_lines

Inputs = Sequence[Sequence[float]]


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """120 steps, in the middle of which both processes are killed."""
    loop = RecordedPair(tmp_path_factory.mktemp("outputs") / "run", b"hi", name="encoder")
    loop.run(lambda: loop.transitions >= 60)
    for side in SIDES:
        loop.kill(side)
    for side in SIDES:
        loop.start(side)
    loop.run(lambda: loop.transitions >= 120)
    loop.stop()
    return loop.folder


def test_a_clean_run_passes(clean: Path) -> None:
    assert failed(clean) == set()
    lines = read_lines(clean / PLANT_TRACE)
    assert sum(line.get("symbol", -1) >= 0 for line in lines) > 50


TWO = (
    ("C = [[1.0, 0.0]] ", "C = [[1.0, 0.0], [0.4, 1.0]] "),
    ("half_widths = [0.0001]", "half_widths = [0.0001, 0.02]"),
    ("half_widths = [0.00012]", "half_widths = [0.00012, 0.024]"),
)
"""The encoder beside a poor sensor of a mixture of position and speed."""


def of_two_outputs(folder: Path) -> tuple[set[str], int]:
    """The checks that a run of two outputs fails, and its keys."""
    loop = RecordedPair(folder / "run", b"hi", name="encoder", changes=TWO)
    loop.run(lambda: loop.transitions >= 120)
    loop.stop()
    lines = read_lines(loop.folder / PLANT_TRACE)
    return failed(loop.folder), sum(line.get("symbol", -1) >= 0 for line in lines)


def test_a_clean_run_of_two_outputs_passes(tmp_path: Path) -> None:
    found, keys = of_two_outputs(tmp_path)
    assert found == set()
    assert keys > 50


def test_ends_that_refuse_a_key_of_two_outputs_fail_the_second_opinion_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A replay asks the ends' own observer, and finds that it was asked correctly."""
    step = BoxObserver.step

    def wary(self: BoxObserver, box: Box, candidates: Inputs, y_next: Vector) -> Observed:
        """No candidate is ruled out where the reading is above 0.05."""
        found = step(self, box, candidates, y_next)
        return found._replace(possible=(0, 1)) if y_next[0] > 0.05 else found

    monkeypatch.setattr(BoxObserver, "step", wary)
    found, _ = of_two_outputs(tmp_path)
    assert found == {"paper"}


def test_what_is_wrong_fails_its_check(clean: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(clean, tmp_path / "run"))
    for trace in (PLANT_TRACE, CONTROLLER_TRACE):
        assert unnoticed(folder, trace, {"transition": ("box", "gauges")}) == []
    for trace in (PLANT_TRACE, CONTROLLER_TRACE):  # also where both ends say the same
        lines = read_lines(folder / trace)
        next(x for x in lines[60:] if x.get("symbol", -1) >= 0)["box"][0][1] -= 1e-9
        write_lines(folder / trace, lines)
    assert "replay" in failed(folder)
    lines = read_lines(clean / PLANT_TRACE)
    next(x for x in lines[60:] if x.get("symbol", -1) >= 0)["true_x_next"][1] += 0.05
    write_lines(folder / PLANT_TRACE, lines)
    assert "plant" in failed(folder)
