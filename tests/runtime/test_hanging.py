"""A call that never comes back is left, and the process ends all the same."""

import time
from threading import Event, Thread

import pytest

from runtime import hanging
from runtime.hanging import leave, within
from tests.support.patience import PATIENCE_S
from tests.support.programs import python


def test_a_call_is_waited_for_no_longer_than_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[Thread] = []
    monkeypatch.setattr(hanging, "_CALLS", calls)  # another test's may hang in this process
    came: list[int] = []
    assert within(PATIENCE_S, lambda: came.append(1))
    assert came == [1]
    over = Event()
    began = time.monotonic()
    assert not within(0.05, over.wait)
    assert time.monotonic() - began < PATIENCE_S
    over.set()
    for call in calls:  # it comes back, and until then leave() ends the process
        call.join(PATIENCE_S)
    with pytest.raises(ZeroDivisionError):
        within(PATIENCE_S, lambda: 1 / 0)
    assert leave(3) == 3, "what came back too late does not end the process"


ENDS = """
import sys, time
from threading import Event
import runtime.command as command
import runtime.hanging

class Held:
    def __del__(self):
        time.sleep(3600)  # as a session of the bus that is taken apart at the interpreter's end

held = Held()

def run():
    runtime.hanging.within(0.05, Event().wait)
    print("flushed")
    return 7

sys.exit(command.entered(run))
"""


def test_a_process_in_which_a_call_hangs_ends_with_its_code() -> None:
    done = python("-c", ENDS)
    assert (done.returncode, done.stdout, done.stderr) == (7, "flushed\n", "")
