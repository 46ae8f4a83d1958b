"""Children: one that ended by itself stays down, one that was killed comes back."""

import subprocess
import sys
import time
from pathlib import Path

import pytest

from protocol.runtime.process import Failure
from wyner.deployment.supervisor import RESTART_S, RESTARTS, Child, Supervisor


class Script(Child):
    """A child that runs a line of Python, and notes each start in its log."""

    def start(self) -> None:
        with self.log.open("a") as log:
            log.write("started\n")
            log.flush()
            self.process = subprocess.Popen(
                [sys.executable, "-S", "-c", *self.arguments],
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=log,
            )

    def starts(self) -> int:
        return self.log.read_text().count("started")


def ended(folder: Path, code: str) -> Script:
    """A child whose process is over."""
    child = Script("plant", [code], folder / "log")
    child.start()
    assert child.process is not None
    child.process.wait(10)
    return child


@pytest.mark.parametrize("code", [0, 1, 2])
def test_who_ended_by_itself_is_not_started_again(tmp_path: Path, code: int) -> None:
    child = ended(tmp_path, f"raise SystemExit({code})")
    for later in (0.0, 10 * RESTART_S, 100 * RESTART_S):
        assert child.poll(later) == code
    child.stop()
    assert child.starts() == 1
    assert child.restarts == 0


def test_who_was_killed_is_started_again_after_a_while(tmp_path: Path) -> None:
    child = ended(tmp_path, "import os; os.kill(os.getpid(), 9)")
    try:
        assert child.poll(5.0) is None
        assert child.poll(5.0 + 0.9 * RESTART_S) is None
        assert child.starts() == 1
        assert child.poll(5.0 + RESTART_S) is None
        assert child.starts() == 2
        assert child.restarts == 1
    finally:
        child.stop()


def test_who_is_killed_too_often_stays_down(tmp_path: Path) -> None:
    child = ended(tmp_path, "import os; os.kill(os.getpid(), 9)")
    child.restarts = RESTARTS
    assert child.poll(1.0) == -9
    child.stop()
    assert child.starts() == 1


def test_a_failure_is_told_with_the_last_line_of_the_log(tmp_path: Path) -> None:
    child = ended(tmp_path, "import sys; print('the reason', flush=True); sys.exit(1)")
    with pytest.raises(Failure, match=r"^plant: the reason \(log: "):
        Supervisor([child], "plant", "").poll()
    child.stop()


def test_a_good_end_is_no_failure(tmp_path: Path) -> None:
    child = ended(tmp_path, "")
    until = time.monotonic() + 3 * RESTART_S
    while time.monotonic() < until:
        Supervisor([child], "plant", "").poll()
        time.sleep(0.02)
    child.stop()
    assert child.starts() == 1
