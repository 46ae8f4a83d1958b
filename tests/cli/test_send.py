"""``wyner send``: which run it joins, how it waits, and what it says."""

import threading
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import pytest

from protocol.messages import SendReply
from runtime.bus_options import BusOptions
from runtime.errors import Failure, UsageError
from wyner.cli import joining
from wyner.cli.joining import joined
from wyner.cli.main import main
from wyner.deployment import running
from wyner.deployment.running import RunningLoop, announced
from wyner.deployment.sending import queued

RUN = RunningLoop("/runs/a/run", "sustained", *(f"tcp/127.0.0.1:{p}" for p in (1, 2, 3)))
NOBODY = "tcp/127.0.0.1:9"


@pytest.fixture
def alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A user without a run, on a machine without services started by hand."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr(joining, "CONTROLLER_MANAGEMENT", NOBODY)


@pytest.mark.usefixtures("alone")
@pytest.mark.parametrize("name", [None, "a/run"])
def test_a_run_that_is_only_being_started_is_waited_for(
    name: str | None, capsys: pytest.CaptureFixture[str]
) -> None:
    """``wyner up & wyner send hi`` found no run, said to start one, and ended with 1."""
    with ExitStack() as note:
        later = threading.Timer(0.3, lambda: note.enter_context(announced(RUN)))
        later.start()
        assert joined(BusOptions(), name, "operator", 30.0)[0] == RUN
        later.join()
        which = "no run" if name is None else "no run 'a/run'"
        said = f"wyner: {which} on this machine yet; waiting 30 s for it\n"
        assert capsys.readouterr().err == said
        assert joined(BusOptions(), name, "operator", 30.0)[0] == RUN
        assert capsys.readouterr().err == ""


@pytest.mark.usefixtures("alone")
def test_the_wait_for_a_run_is_bounded_and_says_what_to_do() -> None:
    begun = time.monotonic()
    with pytest.raises(Failure, match=r"no run on this machine within 0.2 s: start one \(wyner up"):
        joined(BusOptions(), None, "operator", 0.2)
    with pytest.raises(UsageError, match="no run 'b' on this machine, running now: none"):
        joined(BusOptions(), "b", "operator", 0.2)
    assert 0.4 <= time.monotonic() - begun < 10


@pytest.mark.usefixtures("alone")
def test_of_several_runs_one_must_be_named() -> None:
    other = replace(RUN, run_dir="/runs/b/run")
    with announced(RUN), announced(other):
        with pytest.raises(UsageError, match=r"2 runs .* expected --run with one of: a/run, b/run"):
            joined(BusOptions(), None, "dashboard")
        with pytest.raises(UsageError, match=r"no run 'c' on this machine, running now: a/run, b"):
            joined(BusOptions(), "c", "dashboard")
        with pytest.raises(UsageError, match="2 runs end in 'run'"):
            joined(BusOptions(), "run", "dashboard")
        loop, buses = joined(BusOptions(), "b/run", "operator")
        assert loop == other
        assert buses.connect == ["management=tcp/127.0.0.1:1", "management=tcp/127.0.0.1:2"]
        # where an option names the loop, it is that one
        named = BusOptions(connect=["management=tcp/plant:7447"])
        assert joined(named, None, "operator", own=True) == (None, named)


@pytest.mark.usefixtures("alone")
def test_a_run_that_does_not_answer_yet_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    with announced(RUN):
        told = ["send", "--timeout", "0.2", "--id", "mine", "--run", "a/run", "hi"]
        assert main(told) == 1
    said = capsys.readouterr().err
    assert "mine: the run /runs/a/run did not answer within 0.2 s" in said
    assert "(--timeout)" in said


@pytest.mark.usefixtures("alone")
def test_the_run_of_another_folder_is_refused_unless_it_is_named(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Typed where no loop of one's own ran, a message went into a stranger's."""
    with announced(RUN):
        assert main(["send", "--timeout", "0.2", "hi"]) == 2
        said = capsys.readouterr().err
        assert "/runs/a/run, is not of this folder; where it is meant expected --run run" in said
    with monkeypatch.context() as by_hand:
        by_hand.setattr(running, "listens", lambda _endpoint: True)
        assert joined(BusOptions(), None, "dashboard") == (None, BusOptions())
        with (
            announced(RUN),
            pytest.raises(UsageError, match=r"two loops .* expected --run run"),
        ):
            joined(BusOptions(), None, "dashboard")
        assert main(["send", "--timeout", "0.2", "hi"]) == 2
    said = capsys.readouterr().err
    assert "no run of this user on this machine, and services at tcp/127.0.0.1:9" in said
    assert "--connect management=tcp/127.0.0.1:9" in said


def test_the_answer_names_the_run_and_the_loop() -> None:
    reply = SendReply(id="m", accepted=True, queued=2)
    assert str(queued(reply, 22, "loop", "runs/a")) == (
        "queued as m at run runs/a, loop loop: 22 bytes, 2 not delivered yet"
    )
    assert str(queued(reply, 22, "boiler-1", None)) == (
        "queued as m at loop boiler-1: 22 bytes, 2 not delivered yet"
    )
