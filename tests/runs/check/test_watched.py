"""The keyed coin on files, through deaths; its checks, and what they catch."""

import json
import random
import shutil
from pathlib import Path

import pytest

from plant_service.core import PlantCore
from protocol.agreement import predict
from protocol.link.session import TrueStep
from protocol.link.step import Begun
from protocol.vectors import Vector
from runtime.run_folder import CONTROLLER_STATUS, CONTROLLER_TRACE, PLANT_TRACE
from tests.runs.check.mutants import unnoticed
from tests.support.checked_runs import failed
from tests.support.pair import SIDES
from tests.support.recorded_pair import Lines, RecordedPair, read_lines, write_lines
from tests.support.size import size

STEPS = 1400
"""Of M = 4: eleven keys."""


def transitions(folder: Path, trace: Path) -> Lines:
    return [line for line in read_lines(folder / trace) if line["event"] == "transition"]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run in which each end was killed twelve times, at whatever it was doing."""
    folder = tmp_path_factory.mktemp("runs") / "watched"
    draw = random.Random(5)
    loop = RecordedPair(folder, b"The old mill.", name="watched")
    for at in range(500, STEPS, 75):
        loop.run(lambda at=at: loop.transitions >= at)  # type: ignore[misc]
        side = draw.choice(SIDES)
        if draw.random() < 0.5:
            loop.crash_at(side, after=draw.randrange(12))
        else:
            loop.crash_at(side, after=draw.randrange(4), since="transition")
    loop.run(lambda: loop.transitions >= STEPS)
    assert min(loop.lives[side] for side in SIDES) > 3
    loop.stop()
    return folder


def test_no_death_makes_an_alarm_or_a_digit_twice(run: Path) -> None:
    assert failed(run) == set()
    mine, theirs = (transitions(run, trace) for trace in (PLANT_TRACE, CONTROLLER_TRACE))
    served = {(t["session"], *t["digits"], t["k"]) for t in mine if t.get("keyed")}
    positions = {(session, block, at) for session, block, at, _ in served}
    assert len({(session, k) for session, *_, k in served}) == len(positions) == len(served) > 500
    watched = {t["k"]: t["expected"] for t in theirs if "expected" in t}
    assert len(watched) > 500
    coins = {t["k"]: t["coin"] for t in mine}
    assert all(coins[k] == expected for k, expected in watched.items())
    assert not [line for line in read_lines(run / CONTROLLER_TRACE) if line["event"] == "alarm"]


class Ghost:
    """A sensor that shows what candidate 0 would have led to, whatever was applied."""

    acts = device = False
    truth: TrueStep | None = None

    def __init__(self, core: PlantCore) -> None:
        self.core = core
        self.safe, self.close = core.stepper.plant.safe, core.stepper.plant.close

    def begin(self, k: int, x: Vector, u: Vector) -> None:
        self.x = x

    def end(self, k: int) -> Vector:
        step = self.core.state.step
        assert isinstance(step, Begun)
        agreement = self.core.state.rules.agreement
        return predict(agreement.A, agreement.B, self.x, step.offer.candidates[0])


@pytest.fixture(scope="module")
def attacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run whose sensor is spoofed for its last sixty steps, by one who has no key."""
    folder = tmp_path_factory.mktemp("runs") / "attacked"
    loop = RecordedPair(folder, name="watched")
    loop.run(
        lambda: loop.controller.state.keys.stream.left > 100 and loop.transitions > size(300, 600)
    )
    until = loop.transitions + 60
    loop.plant.stepper.plant = Ghost(loop.plant)
    loop.run(lambda: loop.controller.state.record.link.transitions > until)
    loop.stop()
    return folder


def test_a_spoofed_reading_is_an_alarm_and_the_check_finds_it_right(attacked: Path) -> None:
    """One step in four passes: that of candidate 0."""
    lines = read_lines(attacked / CONTROLLER_TRACE)
    alarms = [line for line in lines if line["event"] == "alarm"]
    onset = alarms[0]["j"]
    tested = [t for t in lines if t["event"] == "transition" and t["j"] >= onset]
    assert [a["j"] for a in alarms] == [t["j"] for t in tested if t["expected"] != 0]
    assert 0.5 < len(alarms) / len(tested) < 0.95
    assert not failed(attacked) & {"alarms", "once"}
    status = json.loads((attacked / CONTROLLER_STATUS).read_text())
    assert status["alarms"]["count"] == len(alarms)
    assert status["alarms"]["k"] == alarms[-1]["k"]
    assert status["alarms"]["watched"] > size(100, 400)


def test_an_alarm_that_a_killed_controller_tells_again_is_right(tmp_path: Path) -> None:
    """It was traced, and not saved."""
    loop = RecordedPair(tmp_path / "run", name="watched")
    loop.run(lambda: loop.controller.state.keys.stream.left > 100)
    loop.plant.stepper.plant = Ghost(loop.plant)
    loop.crash_at("controller", after=1, since="alarm")
    loop.run(lambda: loop.lives["controller"] == 2)
    until = loop.transitions + 5
    loop.run(lambda: loop.controller.state.record.link.transitions > until)
    loop.stop()
    lines = read_lines(loop.folder / CONTROLLER_TRACE)
    first, again, *_ = [line for line in lines if line["event"] == "alarm"]
    assert first == again
    assert "alarms" not in failed(loop.folder)


def test_each_field_that_is_otherwise_is_noticed(attacked: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(attacked, tmp_path / "run"))
    alarm = ("session", "j", "k", "reading", "reason", "candidate", "expected", "gauge")
    theirs = {"alarm": alarm, "transition": ("expected", "digits", "keyed")}
    assert unnoticed(folder, CONTROLLER_TRACE, theirs) == []
    assert unnoticed(folder, PLANT_TRACE, {"transition": ("digits", "keyed")}) == []


def test_an_alarm_that_is_missing_is_noticed(attacked: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(attacked, tmp_path / "run"))
    lines = read_lines(folder / CONTROLLER_TRACE)
    lines.remove([line for line in lines if line["event"] == "alarm"][3])
    write_lines(folder / CONTROLLER_TRACE, lines)
    assert "alarms" in failed(folder)
