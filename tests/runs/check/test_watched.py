"""The keyed coin on files, through deaths; its checks, and what they catch."""

import json
import random
import shutil
from pathlib import Path

import pytest

from protocol.scenario.attack import AttackTable
from runtime.run_folder import CONTROLLER_STATUS, CONTROLLER_TRACE, PLANT_TRACE
from tests.runs.check.mutants import unnoticed
from tests.support.checked_runs import failed
from tests.support.pair import SIDES
from tests.support.recorded_pair import RecordedPair, read_lines, write_lines
from tests.support.size import size
from tests.support.traces import events_of

STEPS = 1400
"""Of M = 4: eleven keys."""


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
    mine, theirs = (events_of(run / t, "transition") for t in (PLANT_TRACE, CONTROLLER_TRACE))
    served = {(t["session"], *t["digits"], t["k"]) for t in mine if t.get("keyed")}
    positions = {(session, block, at) for session, block, at, _ in served}
    assert len({(session, k) for session, *_, k in served}) == len(positions) == len(served) > 500
    watched = {t["k"]: t["expected"] for t in theirs if "expected" in t}
    assert len(watched) > 500
    coins = {t["k"]: t["coin"] for t in mine}
    assert all(coins[k] == expected for k, expected in watched.items())
    assert not events_of(run / CONTROLLER_TRACE, "alarm")


ONSET = size(320, 620)


def ghost(folder: Path) -> RecordedPair:
    """A loop whose sensor is spoofed in the end, by one who has no key."""
    attack = AttackTable(kind="ghost", onset=ONSET, knows=("model", "bus"))
    return RecordedPair(folder, name="watched", attack=attack)


@pytest.fixture(scope="module")
def attacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    loop = ghost(tmp_path_factory.mktemp("runs") / "attacked")
    loop.run(lambda: loop.transitions > ONSET + 60)
    loop.stop()
    return loop.folder


def test_a_spoofed_reading_is_an_alarm_and_the_check_finds_it_right(attacked: Path) -> None:
    """One step in four passes: that of the candidate that Eve guesses."""
    alarms = events_of(attacked / CONTROLLER_TRACE, "alarm")
    assert all(alarm["k"] >= ONSET - 1 for alarm in alarms)
    assert 0.5 < len(alarms) / 60 < 0.95
    assert failed(attacked) == set()
    status = json.loads((attacked / CONTROLLER_STATUS).read_text())
    assert status["alarms"]["count"] == len(alarms)
    assert status["alarms"]["k"] == alarms[-1]["k"]
    assert status["alarms"]["watched"] > size(100, 400)


def test_an_alarm_that_a_killed_controller_tells_again_is_right(tmp_path: Path) -> None:
    """It was traced, and not saved."""
    loop = ghost(tmp_path)
    loop.crash_at("controller", after=1, since="alarm")
    loop.run(lambda: loop.lives["controller"] == 2)
    until = loop.transitions + 5
    loop.run(lambda: loop.transitions > until)
    loop.stop()
    first, again, *_ = events_of(loop.folder / CONTROLLER_TRACE, "alarm")
    assert first == again
    assert failed(loop.folder) == set()


def test_what_is_otherwise_or_missing_is_noticed(attacked: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(attacked, tmp_path / "run"))
    alarm = ("session", "j", "k", "reading", "reason", "candidate", "expected", "gauge")
    theirs = {"alarm": alarm, "transition": ("expected", "digits", "keyed")}
    assert unnoticed(folder, CONTROLLER_TRACE, theirs) == []
    assert unnoticed(folder, PLANT_TRACE, {"transition": ("digits", "keyed")}) == []
    lines = read_lines(folder / CONTROLLER_TRACE)
    lines.remove([line for line in lines if line["event"] == "alarm"][3])
    write_lines(folder / CONTROLLER_TRACE, lines)
    assert "alarms" in failed(folder)
