"""A guest's code stays a guest: whatever she does, she stops herself alone."""

import os
import time
from pathlib import Path

import pytest

from protocol.messages import Offer
from tap_service import sandboxed as guests
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers import KnowledgeError
from tap_service.sandboxed import sandboxed
from tap_service.status import Listener
from tests.support.patience import PATIENCE_S
from tests.support.recorded_pair import law_of
from wyner.simulate.engine import simulate_runs, transfer
from wyner.simulate.engine.taps import EavesdropperError, listen

KNOWLEDGE = law_of("sustained")[0].knowledge()

GUEST = """
import os, sys, time
import numpy as np
from tap_service.eavesdroppers import Belief, Eavesdropper, Guess
{before}
class Mine(Eavesdropper):
    name = "mine"
    def observe(self, transition):
        if transition.k == 2:
            {act}
        return Guess(transition.k, (0.25, 0.75), 1.0)
    def belief(self):
        return Belief(message=b"hm", whole=(b"a", b"b"), whole_count=2)
    def message_symbols(self):
        return zip(np.arange(1, 3), np.arange(2, dtype=np.int8))
"""


def step(k: int) -> Transition:
    return Transition("0" * 16, k, (0.1, 0.2), ((0.0,), (1.0,)), 1, (0.3, 0.4))


def guest(tmp_path: Path, act: str = "pass", before: str = "") -> str:
    path = tmp_path / "mine.py"
    path.write_text(GUEST.format(act=act, before=before))
    return f"{path}:Mine"


def test_she_guesses_and_believes_as_in_the_taps_own_process(tmp_path: Path) -> None:
    listener = Listener.of(sandboxed(guest(tmp_path, 'print("hello" * 100000)')), KNOWLEDGE)
    guesses = [listener.observe(step(k)) for k in range(5)]
    assert [g and (g.k, g.symbol, g.best) for g in guesses] == [
        (k, (0.25, 0.75), 1) for k in range(5)
    ]
    belief = listener.belief()
    assert (belief.message, belief.whole) == (b"hm", (b"a", b"b"))
    assert listener.message_symbols() == [(1, 0), (2, 1)]
    assert listener.review() == []
    assert listener.failed == ""
    assert belief.keys is None


HEARS = """
import sys
from tap_service.eavesdroppers import Belief, Eavesdropper, Guess
from tap_service.eavesdroppers.base import KeysHeld
class Mine(Eavesdropper):
    name = "mine"
    hears_messages = True
    heard = 0
    def hear(self, message):
        self.heard += 1
        if message.k == 7:
            raise ValueError("not that one")
    def observe(self, transition):
        return Guess(transition.k, (0.25, 0.75), 1.0)
    def belief(self):
        none = dict.fromkeys(("blocks", "broken", "bits", "missed"), 0)
        return Belief(keys=KeysHeld(**none, copies=self.heard, at_most=1, refuted=0, bursts=0))
"""


def test_she_hears_messages_where_she_asks_to(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text(HEARS)
    listener = Listener.of(sandboxed(f"{path}:Mine"), KNOWLEDGE)
    offer = Offer(session="f" * 16, k=0, candidates=((0.1,), (0.2,)), cipher=0)
    listener.hear(offer)
    listener.hear(offer)
    keys = listener.belief().keys
    assert keys is not None
    assert keys.copies == 2
    listener.hear(offer.model_copy(update={"k": 7}))
    assert "a message: ValueError: not that one" in listener.failed


@pytest.mark.slow
@pytest.mark.parametrize(
    ("act", "why"),
    [
        ("sys.exit(0)", "the process ended"),
        ("os._exit(3)", "the process ended"),
        ("raise ValueError('no\\nidea')", "ValueError: no idea"),
        ("return 'nothing of the kind'", "TypeError: expected a Guess"),
        ("x = bytearray(8 << 30)", "MemoryError"),
        ("[os.close(fd) for fd in range(3, 20)]", ""),
        ("time.sleep(60)", "too slow"),
        ("while True: pass", "too slow"),
    ],
)
def test_what_she_does_stops_her_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, act: str, why: str
) -> None:
    monkeypatch.setattr(guests, "LIGHT_S", 2.0 if "too slow" in why else PATIENCE_S)
    listener = Listener.of(sandboxed(guest(tmp_path, act)), KNOWLEDGE)
    guesses = [listener.observe(step(k)) for k in range(4)]
    assert [g is not None for g in guesses] == [True, True, False, False]
    assert listener.failed.startswith("step 2: ")
    assert why in listener.failed
    assert listener.belief().message == b""


@pytest.mark.slow
def test_what_she_started_in_her_group_ends_with_her(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(guests, "LIGHT_S", 2.0)
    note = tmp_path / "pid"
    forking = (
        f"child = os.fork(); child and open({str(note)!r}, 'w').write(str(child)); time.sleep(60)"
    )
    listener = Listener.of(sandboxed(guest(tmp_path, forking)), KNOWLEDGE)
    for k in range(3):
        listener.observe(step(k))
    assert "too slow" in listener.failed
    child = int(note.read_text())
    until = time.monotonic() + PATIENCE_S
    while Path(f"/proc/{child}/stat").exists() and time.monotonic() < until:
        if Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()[0] == "Z":
            break
        time.sleep(0.02)
    else:
        assert not Path(f"/proc/{child}/stat").exists()
    assert os.getpid() != child


@pytest.mark.slow
@pytest.mark.parametrize(
    ("before", "why"),
    [
        ("sys.exit(1)", "cannot be loaded: the process ended"),
        ("raise RuntimeError('no')", "no"),
        ("time.sleep(60)", "cannot be loaded: too slow"),
    ],
)
def test_one_that_cannot_be_loaded_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, before: str, why: str
) -> None:
    monkeypatch.setattr(guests, "START_S", 3.0 if "too slow" in why else PATIENCE_S)
    with pytest.raises(KnowledgeError) as error:
        sandboxed(guest(tmp_path, before=before))
    assert why in str(error.value)
    assert "\n" not in str(error.value)


def test_in_a_sweep_the_line_names_her(tmp_path: Path) -> None:
    scenario, law = law_of("sustained")
    runs = simulate_runs(scenario, law, seed=1, runs=range(1), steps=5, record=True)
    with pytest.raises(EavesdropperError, match=r"mine.py:Mine: step 2: ValueError: no idea"):
        listen(runs, transfer(runs), [guest(tmp_path, "raise ValueError('no\\nidea')")], 0)
    (tmp_path / "fine").mkdir()
    (heard,) = listen(runs, transfer(runs), [guest(tmp_path / "fine")], 0)
    assert heard.read == 0
