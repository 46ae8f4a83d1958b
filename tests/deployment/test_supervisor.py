"""What the supervisor of a run does with processes that end otherwise than asked."""

import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from runtime.host import LAST_S
from runtime.services import SERVICES
from runtime.zenoh_bus import CLOSE_S
from tests.support.patience import PATIENCE_S
from wyner.deployment.supervisor import Child

LEAVES = """
import subprocess, sys, time
code = "import sys, time\\nwhile True:\\n open(sys.argv[1], 'a').write('x'); time.sleep(0.01)"
subprocess.Popen([sys.executable, "-c", code, sys.argv[1]])
time.sleep(60)
"""


@pytest.fixture
def killed(tmp_path: Path) -> Iterator[tuple[Child, Path]]:
    """A service that was killed, and left a process that goes on writing."""
    written = tmp_path / "guesses"
    child = Child(SERVICES["tap"], [], tmp_path / "log")
    child.process = subprocess.Popen(
        [sys.executable, "-c", LEAVES, str(written)], stdin=subprocess.PIPE, process_group=0
    )
    until = time.monotonic() + PATIENCE_S
    while not written.exists() and time.monotonic() < until:
        time.sleep(0.01)
    child.process.kill()
    child.process.wait()
    yield child, written
    assert child.process.stdin is not None
    child.process.stdin.close()


@pytest.mark.parametrize("how", ["poll", "stop"])
def test_what_a_killed_service_has_left_ends_with_it(killed: tuple[Child, Path], how: str) -> None:
    """The eavesdroppers of a killed tap wrote on in a run that was sealed, and beside her next."""
    child, written = killed
    if how == "poll":
        child.poll(0.0)
    else:
        child.stop()
    size = written.stat().st_size
    time.sleep(0.2)
    assert written.stat().st_size == size


@pytest.mark.parametrize("end", ["plant", "controller"])
def test_an_end_is_given_the_time_that_it_takes_to_stop(end: str) -> None:
    """It was killed after five seconds, while it still said farewell."""
    longest_s = 2 * LAST_S + 2 * CLOSE_S
    assert SERVICES[end].stop_s >= longest_s
