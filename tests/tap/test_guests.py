"""The process beside the mirror, and a user's eavesdropper in it, who stops herself alone."""

import json
import logging
import time
from pathlib import Path
from typing import Any

import pytest

from protocol.messages import FieldMessage, TapStatus
from runtime.recording import Bounds
from runtime.run_folder import BELIEFS, CAPTURE
from studies.secrecy.runs import Run, simulate
from tap_service.analysis import Assignment
from tap_service.beside import Beside
from tap_service.capture.channel import View
from tap_service.capture.recording import RotatingLog, mirror_line
from tests.support.patience import PATIENCE_S, wait_for
from tests.support.recorded_pair import law_of
from tests.tap.test_service import Wire, config
from wyner.runs.run import guess_logs
from wyner.simulate.engine import simulate_runs, transfer
from wyner.simulate.engine.taps import EavesdropperError, listen

LOG = logging.getLogger("test")
GUEST = """
import os, sys, time
import numpy as np
from tap_service.eavesdroppers import Belief, Eavesdropper, Guess
class Mine(Eavesdropper):
    name = "mine"
    hears_messages = True
    heard = 0
    def hear(self, message):
        self.heard += 1
    def observe(self, transition):
        if transition.k == 2:
            {act}
        return Guess(transition.k, (0.25, 0.75), 1.0)
    def belief(self):
        return Belief(message=b"%d" % self.heard, whole=(b"a", b"b"), whole_count=2)
    def message_symbols(self):
        return zip(np.arange(1, 3), np.arange(2, dtype=np.int8))
"""


@pytest.fixture(scope="module")
def run() -> Run:
    return simulate(6, 11)


def guest(tmp_path: Path, act: str = "pass") -> str:
    path = tmp_path / "mine.py"
    path.write_text(GUEST.format(act=act))
    return f"{path}:Mine"


def header(run: Run, view: View) -> dict[str, object]:
    return {
        "loop": "loop",
        "knowledge": run.scenario.knowledge().model_dump(mode="json"),
        "view": view.model_dump(mode="json"),
    }


def record(run: Run, run_dir: Path, view: View) -> None:
    log = RotatingLog(run_dir / CAPTURE, header(run, view), Bounds(free_bytes=0), LOG)
    for i, message in enumerate(run.messages):
        log.write(mirror_line(i, message.topic, message.wire()))
    log.close()


def beside(run: Run, run_dir: Path, name: str, answer_s: float = 0.0) -> Beside:
    """The process beside the mirror, with one eavesdropper."""
    told, limits = {name: run.scenario.knowledge()}, Bounds(free_bytes=0)
    guesses = Path("tap/analysis-1.jsonl")
    return Beside(Assignment(run_dir, guesses, told, limits, header(run, View()), answer_s), LOG)


def said_by(process: Beside, run: Run) -> list[tuple[TapStatus, dict[str, Any]]]:
    """What she says when no more is captured."""
    process.finish()
    try:
        for _ in process.last_reports(time.monotonic() + PATIENCE_S, len(run.messages)):
            pass
        return list(process.reports(len(run.messages)))
    finally:
        process.close()


def heard(
    tmp_path: Path, run: Run, act: str, answer_s: float = PATIENCE_S
) -> tuple[TapStatus, dict[str, Any]]:
    """What she says at the end of a capture."""
    record(run, tmp_path, View())
    (report,) = said_by(beside(run, tmp_path, guest(tmp_path, act), answer_s), run)
    return report


@pytest.mark.slow
def test_it_waits_for_a_capture_of_its_own_settings(run: Run, tmp_path: Path) -> None:
    record(run, tmp_path, View(loss=0.5))
    process = beside(run, tmp_path, "nearest-centre")
    assert list(process.reports(0)) == []
    record(run, tmp_path, View())
    wait_for(lambda: list(process.reports(0)), "a first look")
    ((status, _),) = said_by(process, run)
    assert (status.steps, status.behind, status.unused.dropped) == (6, 0, 0)


@pytest.mark.slow
def test_it_ends_also_while_it_waits(run: Run, tmp_path: Path) -> None:
    assert said_by(beside(run, tmp_path, "nearest-centre"), run) == []


@pytest.mark.slow
def test_she_guesses_and_believes_as_in_the_taps_own_process(run: Run, tmp_path: Path) -> None:
    status, record = heard(tmp_path, run, 'print("hello" * 100000)')
    assert (status.failed, status.behind, status.steps) == ("", 0, 6)
    assert [guess.symbol for guess in status.tail] == [1] * 6
    assert status.belief.message == str(len(run.messages))
    assert (record["whole"], record["whole_count"]) == (["YQ==", "Yg=="], 2)
    assert record["symbols"] == [[1, 0], [2, 1]]
    (log,) = guess_logs(tmp_path)[1:]
    steps = [json.loads(line).get("k") for line in log.read_bytes().splitlines()]
    assert steps[1:-1] == list(range(6))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("act", "why"),
    [
        ("sys.exit(0)", "its process died"),
        ("os._exit(3)", "its process died (exit code 3)"),
        ("raise ValueError('no\\nidea')", "step 2: ValueError: no idea"),
        ("x = bytearray(8 << 30)", "step 2: MemoryError"),
        ("[os.close(fd) for fd in range(3, 20)]", "its process died"),
        ("time.sleep(60)", "too slow: no answer within 1 s"),
        ("while True: pass", "too slow: no answer within 1 s"),
    ],
)
def test_what_she_does_stops_her_alone(run: Run, tmp_path: Path, act: str, why: str) -> None:
    status, record = heard(tmp_path, run, act, 1.0 if "too slow" in why else PATIENCE_S)
    assert status.failed.startswith(why)
    assert record["symbols"] is None
    assert status.steps <= 2


@pytest.mark.slow
def test_what_she_started_in_her_group_ends_with_her(run: Run, tmp_path: Path) -> None:
    """It holds her line open as well: that she ended is noticed all the same."""
    note = tmp_path / "pid"
    forking = (
        f"child = os.fork(); child and open({str(note)!r}, 'w').write(str(child)); time.sleep(60)"
    )
    status, _ = heard(tmp_path, run, forking, 1.0)
    assert "too slow" in status.failed
    stat = Path(f"/proc/{int(note.read_text())}/stat")
    wait_for(lambda: not stat.exists() or " Z " in stat.read_text(), "the end of what she started")


@pytest.mark.slow
def test_the_mirror_and_the_others_go_on(run: Run, tmp_path: Path) -> None:
    """A guest who has not answered yet holds up nobody who listens in the mirror's process."""
    (tmp_path / "own").mkdir()
    names = ("nearest-centre", guest(tmp_path / "own", "time.sleep(600)"))
    wire = Wire(config(run, tmp_path, names=names, finish_s=0.5))
    messages: tuple[FieldMessage, ...] = run.messages
    for message in messages:
        wire.send(message)
    wire.service.work(0)
    wire.service.publish()
    assert wire.statuses[-1].mirrored == len(messages)
    wire.finish()
    beliefs = json.loads((tmp_path / BELIEFS).read_bytes())
    assert (beliefs["nearest-centre"]["steps"], beliefs["nearest-centre"]["failed"]) == (6, "")
    assert "mine" not in beliefs or beliefs["mine"]["behind"] > 0


def test_in_a_sweep_the_line_names_her(tmp_path: Path) -> None:
    scenario, law = law_of("sustained")
    runs = simulate_runs(scenario, law, seed=1, runs=range(1), steps=5, record=True)
    with pytest.raises(EavesdropperError, match=r"mine.py:Mine: step 2: ValueError: no idea"):
        listen(runs, transfer(runs), [guest(tmp_path, "raise ValueError('no\\nidea')")], 0)
    (tmp_path / "fine").mkdir()
    (found,) = listen(runs, transfer(runs), [guest(tmp_path / "fine")], 0)
    assert found.read == 0
