"""Two live loops by turns: who stands still makes no step, and the faster one is told."""

import shutil
from pathlib import Path

import pytest

from benchmarks import in_turn as module
from benchmarks.in_turn import in_turn
from runtime.errors import Failure
from runtime.run_folder import CONTROLLER_TRACE
from runtime.shipped import SCENARIOS


def shipped(folder: Path) -> Path:
    return Path(shutil.copy(SCENARIOS / "sustained.toml", folder / "scenario.toml"))


@pytest.mark.long
@pytest.mark.integration
def test_the_ratio_of_two_loops_that_are_one_is_about_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "WARM_UP_S", 1.0)
    monkeypatch.setattr(module, "BLOCK", 1)
    lines: list[str] = []
    told = in_turn({"one": shipped, "other": shipped}, blocks=5, seconds=0.3, progress=lines.append)
    assert 0.5 < told["ratio"] < 2
    assert told["low"] < told["ratio"] < told["high"]
    assert len(told["ratios"]) == len(lines) == 5
    assert min(told["steps_per_second"].values()) > 50


@pytest.mark.long
@pytest.mark.integration
def test_a_loop_that_makes_no_step_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "WARM_UP_S", 1.0)
    monkeypatch.setattr(module, "BLOCK", 1)
    monkeypatch.setattr(module.Loop, "turn", lambda loop, _seconds: setattr(loop, "seconds", 1.0))
    with pytest.raises(Failure, match="no step in 1 turns"):
        in_turn({"one": shipped, "other": shipped}, blocks=1, seconds=0.5)


def test_the_newest_step_is_read_in_the_newest_part_of_a_trace_that_tells_one(
    tmp_path: Path,
) -> None:
    trace = tmp_path / CONTROLLER_TRACE
    trace.parent.mkdir(parents=True)
    loop = module.Loop([], tmp_path)
    with pytest.raises(Failure, match="no step was recorded"):
        loop.steps()
    trace.write_text('{"k":3}\n')
    trace.with_suffix(".0001.jsonl").write_text('{"k":41}\n{"j":2,"k":42}\n')
    trace.with_suffix(".0002.jsonl").write_text('{"part":2}\n')
    assert loop.steps() == 42
