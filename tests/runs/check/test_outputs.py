"""``wyner check`` of a plant that is read through some outputs alone: its box, and its truth."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from runtime.run_folder import CONTROLLER_TRACE, PLANT_TRACE
from tests.support.checked_runs import failed
from tests.support.recorded_loop import RecordedLoop
from tests.support.small_run import read_lines, write_lines
from tests.support.two_ends import SIDES

Line = dict[str, Any]


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """120 steps, in the middle of which both processes are killed."""
    loop = RecordedLoop(tmp_path_factory.mktemp("outputs") / "run", b"hi", "encoder")
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


def low(line: Line) -> None:
    line["box"][0][1] -= 1e-9


def truth(line: Line) -> None:
    line["true_x_next"][1] += 0.05


def gauge(line: Line) -> None:
    line["gauges"][0] *= 1 + 1e-12


def no_box(line: Line) -> None:
    del line["box"]


@pytest.mark.parametrize(
    ("traces", "edit", "check"),
    [
        ((PLANT_TRACE,), low, "traces"),
        ((PLANT_TRACE, CONTROLLER_TRACE), low, "traces"),
        ((PLANT_TRACE,), no_box, "traces"),
        ((PLANT_TRACE,), truth, "reachable"),
        ((PLANT_TRACE, CONTROLLER_TRACE), gauge, "agreement"),
    ],
)
def test_what_is_wrong_fails_its_check(
    clean: Path,
    tmp_path: Path,
    traces: tuple[Path, ...],
    edit: Callable[[Line], None],
    check: str,
) -> None:
    folder = tmp_path / "run"
    shutil.copytree(clean, folder)
    for name in traces:
        lines = read_lines(folder / name)
        edit(next(x for x in lines[60:] if x.get("symbol", -1) >= 0))
        write_lines(folder / name, lines)
    assert check in failed(folder)
