"""A pipe in the place of a file: no command waits for somebody to write into it."""

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.support.patience import PATIENCE_S
from wyner.cli.main import main

NAMED = (
    ("score", "PIPE"),
    ("report", "PIPE", "--output", "OUT.csv"),
    ("design", "PIPE"),
    ("fit", "PIPE", "--output", "OUT"),
    ("sweep", "PIPE"),
    ("sweep", "PIPE", "--plot", "OUT.svg"),
    ("sweep", "fig7-paper-20", "--output", "PIPE", "--resume"),
    ("send", "@PIPE"),
    ("up", "--message", "@PIPE"),
    ("up", "--scenario", "PIPE"),
    ("tap", "--run-dir", "OUT", "--knowledge", "PIPE"),
    ("plant", "--run-dir", "OUT", "--fleet", "PIPE"),
    ("certs", "FOLDER", "--name", "plant"),
)


class Waited(BaseException):
    """No command may take it for an error of its own."""


@pytest.fixture
def in_time() -> Iterator[None]:
    """What waits for a writer is interrupted, and the test fails."""

    def late(_signal: int, _frame: object) -> None:
        raise Waited

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, PATIENCE_S)
    yield
    signal.setitimer(signal.ITIMER_REAL, 0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture
def said(capsys: pytest.CaptureFixture[str], in_time: None) -> Callable[[list[str]], str]:
    def told(arguments: list[str]) -> str:
        signal.setitimer(signal.ITIMER_REAL, PATIENCE_S)
        code = main(arguments)
        err = capsys.readouterr().err
        assert code in (0, 1, 2), arguments
        assert "unexpected" not in err, (arguments, err)
        return err

    return told


@pytest.mark.parametrize("command", NAMED, ids=" ".join)
def test_no_command_waits_at_a_pipe_that_it_is_given(
    tmp_path: Path,
    said: Callable[[list[str]], str],
    monkeypatch: pytest.MonkeyPatch,
    command: tuple[str, ...],
) -> None:
    """It says in a line what stands there."""
    monkeypatch.chdir(tmp_path)
    pipe, certs = tmp_path / "pipe", tmp_path / "certs"
    certs.mkdir()
    for path in (pipe, certs / "ca.pem"):
        os.mkfifo(path)
    (certs / "ca-key.pem").touch()
    words = {
        "PIPE": str(pipe),
        "OUT": str(tmp_path / "out"),
        "FOLDER": str(certs),
    }
    told = said(
        [words.get(w, w.replace("OUT", words["OUT"]).replace("PIPE", str(pipe))) for w in command]
    )
    assert len(told.splitlines()) == 1, told
    assert str(pipe) in told or str(certs) in told
