"""A program stops when it is told to, in each of the ways."""

import os
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from runtime.signals import stop_on_signals
from tests.support.patience import PATIENCE_S
from tests.support.programs import python, started


def test_a_signal_sets_the_event_and_a_second_one_raises() -> None:
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt), stop_on_signals() as stopping:
        assert not stopping.is_set()
        os.kill(os.getpid(), signal.SIGTERM)
        assert stopping.wait(5)
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(5)
    assert signal.getsignal(signal.SIGTERM) is before


STOPS = """
import sys
from runtime.signals import stop_on_signals
with stop_on_signals() as stopping:
    print("ready", flush=True)
    print("stopped" if stopping.wait({wait}) else "still running", flush=True)
"""


@contextmanager
def stopping_child(wait: float, **environment: str) -> Iterator["subprocess.Popen[str]"]:
    streams = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    code = STOPS.format(wait=wait)
    with started("-c", code, env={**os.environ, **environment}, **streams) as child:
        assert child.stdout.readline() == "ready\n"
        yield child


def test_a_service_stops_when_its_standard_input_ends() -> None:
    with stopping_child(PATIENCE_S, WYNER_STOP_WITH_STDIN="1") as child:
        assert child.communicate(timeout=PATIENCE_S)[0] == "stopped\n"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_service_stops_on_a_signal(number: signal.Signals) -> None:
    with stopping_child(PATIENCE_S) as child:
        child.send_signal(number)
        assert child.communicate(timeout=PATIENCE_S)[0] == "stopped\n"
        assert child.returncode == 0


HANDED_TO_ANOTHER_THREAD = """
import os, signal, threading
from runtime.signals import stop_on_signals
with stop_on_signals() as stopping:
    threading.Thread(target=threading.Event().wait, daemon=True).start()
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM])  # the other thread takes it
    threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGTERM)).start()
    stopping.wait()
"""


def test_a_signal_that_another_thread_takes_ends_the_wait() -> None:
    assert python("-c", HANDED_TO_ANOTHER_THREAD).returncode == 0


LOST = """
import sys, time
from runtime.command import entered

class Finalised:
    def __del__(self):
        raise KeyboardInterrupt

def command():
    thing = Finalised()
    del thing
    for _ in range(500):
        time.sleep(0.02)
    return 0

sys.exit(entered(command))
"""


def test_an_interrupt_in_a_finaliser_is_not_lost() -> None:
    """Ctrl-C in a demo's first second was once swallowed, and the demo ran on to its end."""
    done = python("-c", LOST)
    assert (done.returncode, done.stderr) == (130, "")
