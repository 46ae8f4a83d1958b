"""How much processor time a guest may use, and that what goes on between its answers ends."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from runtime.processor_time import LOADING_S, PROCESSOR_S, PROCESSOR_SHARE, Meter
from runtime.sandbox import OVERSPENT, SandboxError, SandboxProcess
from tests.support.patience import PATIENCE_S


def test_a_guest_has_for_an_answer_what_the_answer_may_take() -> None:
    meter = Meter(now=100.0)
    assert not meter.overspent(LOADING_S, 100.0)
    meter.ask(2.0, 110.0, 1.5)  # it took 1.5 s of processor time to be loaded
    beside = 1.5 + PROCESSOR_S + PROCESSOR_SHARE * 11
    assert not meter.overspent(beside + 0.9, 111.0)
    assert meter.overspent(beside + 1.1, 111.0)
    # not more for an answer than it may take, whenever whoever asks looks at it again
    beside = 1.5 + PROCESSOR_S + PROCESSOR_SHARE * 100
    assert not meter.overspent(beside + 1.9, 200.0)
    assert meter.overspent(beside + 2.1, 200.0)
    meter.answer(111.0)
    assert not meter.overspent(beside + 0.9, 200.0)
    assert meter.overspent(beside + 1.1, 200.0)
    meter.ask(2.0, 200.0, 50.0)  # what it used since is not what it took to be loaded
    assert meter.overspent(beside + 1.1, 200.0)


GRANTED_S = 1.0
"""What these guests have beside their answers: less than :data:`PROCESSOR_S`, to be over sooner."""

GUEST = f"""
import os, sys, threading
from runtime import processor_time
from runtime.sandbox import serve

processor_time.PROCESSOR_S = {GRANTED_S}

def spin():
    while True:
        pass

def answer(what, argument):
    if what == "thread":
        threading.Thread(target=spin).start()
    elif what == "child" and os.fork() == 0:
        os.setsid()
        spin()
    elif what == "loop":
        spin()
    elif what == "weight":
        with open("/proc/self/autogroup") as file:
            return file.read().split()[1:]
    return "fine"

serve(answer)
"""


@pytest.fixture
def guest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SandboxProcess:
    (tmp_path / "looping_guest.py").write_text(GUEST)
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{Path(__file__).resolve().parents[2]}")
    return SandboxProcess("looping_guest")


@pytest.mark.skipif(not Path("/proc/self/autogroup").exists(), reason="no autogroup here")
def test_a_nice_programs_guest_is_as_nice_as_a_session(
    guest: SandboxProcess, tmp_path: Path
) -> None:
    own = os.nice(0)
    assert guest.ask("weight", None, PATIENCE_S) == ["nice", str(own)]
    guest.close()
    asks = "from runtime.sandbox import SandboxProcess\nimport os\nos.nice(7)\n"
    asks += "print(SandboxProcess('looping_guest').ask('weight', None, 240.0))"
    told = subprocess.run([sys.executable, "-c", asks], capture_output=True, text=True, check=True)
    assert told.stdout == f"['nice', '{min(own + 7, 19)}']\n"


@pytest.mark.slow
@pytest.mark.parametrize("what", ["thread", "child"])
def test_what_loops_between_the_answers_is_ended(guest: SandboxProcess, what: str) -> None:
    assert guest.ask(what, None, PATIENCE_S) == "fine"
    began, until = time.monotonic(), time.monotonic() + PATIENCE_S
    with pytest.raises(SandboxError) as error:
        while time.monotonic() < until:
            time.sleep(0.2)
            assert guest.ask("is it there?", None, PATIENCE_S) == "fine"
    assert str(error.value) == f"more than {PROCESSOR_S:g} s of processor time beside its answers"
    assert time.monotonic() - began > 0.9 * GRANTED_S / 2


@pytest.mark.slow
def test_a_loop_ends_though_whoever_asked_does_not_look(guest: SandboxProcess) -> None:
    """Nobody waits for the answer: the asker may be stopped."""
    guest.begin("loop", None, 0.5)
    assert guest.child.wait(PATIENCE_S) == OVERSPENT
