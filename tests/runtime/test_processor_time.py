"""Processor time of a process and of all that comes from it, told by the kernel in either way."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from runtime import processor_time
from runtime.processor_time import children_of, used_by_s
from tests.support.patience import PATIENCE_S

ROOT = Path(__file__).resolve().parents[2]

FAMILY = """
import os, threading, time

def work(seconds):
    until = time.process_time() + seconds
    while time.process_time() < until:
        pass

gone = os.fork()
if not gone:
    work(0.3)
    os._exit(0)
os.waitpid(gone, 0)

def fork():
    if not os.fork():
        work(0.2)
        os.fork()  # both stay
        time.sleep(1000)

thread = threading.Thread(target=fork)
thread.start()
thread.join()
time.sleep(0.6)
print("ready", flush=True)
time.sleep(1000)
"""


@pytest.fixture(params=[True, False], ids=["its children alone", "all processes"])
def told(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> bool:
    if request.param and not processor_time.CHILDREN_TOLD:
        pytest.skip("this kernel does not tell a process's children")
    monkeypatch.setattr(processor_time, "CHILDREN_TOLD", request.param)
    return bool(request.param)


@pytest.fixture
def family() -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-c", FAMILY]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        yield process
        os.killpg(process.pid, signal.SIGKILL)


@pytest.mark.usefixtures("told")
def test_who_has_ended_and_who_came_of_a_thread_counts(family: subprocess.Popen[str]) -> None:
    (child,) = children_of(family.pid)
    (grandchild,) = children_of(child)
    assert children_of(grandchild) == []
    assert family.pid in children_of(os.getpid())
    assert 0.15 <= used_by_s(child) < used_by_s(family.pid)
    assert used_by_s(family.pid) >= 0.45


@pytest.mark.usefixtures("told")
def test_of_who_is_gone_nothing_is_told() -> None:
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait(PATIENCE_S)
    assert children_of(process.pid) == []
    assert used_by_s(process.pid) == 0.0


OWN = """
import subprocess, sys, time
from runtime import processor_time
from runtime.processor_time import used_s

processor_time.CHILDREN_TOLD = sys.argv[1] == "True"
while time.process_time() < 0.5:
    pass
own = used_s()
subprocess.run([sys.executable, "-c", "sum(range(10_000_000))"], check=True)
print(own, used_s())
"""


def test_a_processs_own_time_is_not_that_of_its_descendants(told: bool) -> None:
    command = [sys.executable, "-c", OWN, str(told)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    own, with_a_child = map(float, done.stdout.split())
    assert own == 0.0
    assert with_a_child > 0.05
