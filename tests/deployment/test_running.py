"""Notes of the loops that run on this machine: found, told apart, and gone with their process."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import pytest

from wyner.deployment.running import RunningLoop, announced, notes_folder, running_loops

ANNOUNCES = (
    "import sys; from wyner.deployment.running import RunningLoop, announced;"
    "loop = RunningLoop(**{!r})\n"
    "with announced(loop): print(flush=True); sys.stdin.read()"
)


def loop_named(name: str) -> RunningLoop:
    ends = [f"tcp/127.0.0.1:{port}" for port in (1, 2, 3)]
    return RunningLoop(f"/runs/{name}", "sustained", *ends)


@pytest.fixture(autouse=True)
def runtime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path


@pytest.fixture
def another() -> Iterator[int]:
    """A second process that announces the run ``b``."""
    code = ANNOUNCES.format(asdict(loop_named("b")))
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", code], stdin=pipe, stdout=pipe) as process:
        assert process.stdout is not None
        process.stdout.readline()
        yield process.pid
        process.kill()


def test_a_note_stands_as_long_as_its_run(runtime: Path) -> None:
    assert running_loops() == []
    with announced(loop_named("a")):
        assert running_loops() == [loop_named("a")]
    assert running_loops() == []
    assert list((runtime / "wyner").iterdir()) == []
    assert (runtime / "wyner").stat().st_mode & 0o77 == 0


def test_a_note_whose_process_was_killed_is_taken_away(another: int, runtime: Path) -> None:
    (note,) = (runtime / "wyner").glob("*.json")
    assert running_loops() == [loop_named("b")]
    os.kill(another, 9)
    while running_loops():
        pass
    assert not note.exists()


def test_a_run_is_named_by_its_path_from_here() -> None:
    """Two runs in ``a/run`` and ``b/run`` were both announced as ``run``."""
    run = loop_named("a/run")
    assert run.seen_from(Path("/runs")) == "a/run"
    assert run.seen_from(Path("/runs/a")) == "run"
    for elsewhere in ("/runs/b", "/runs/a/run", "/runs/a/ru"):
        assert run.seen_from(Path(elsewhere)) == "/runs/a/run"
    assert run.is_called("a/run")
    assert run.is_called("/runs/a/run")
    assert not run.is_called("b/run")


def test_notes_that_are_no_notes_are_passed_over(runtime: Path) -> None:
    folder = notes_folder()
    (folder / "1.json").write_text("{")
    (folder / "2.json").write_text(json.dumps({"run_dir": 1}))
    assert running_loops() == []


def test_a_folder_that_is_somebody_elses_is_not_used(
    runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (runtime / "wyner").symlink_to(runtime)
    with pytest.raises(OSError, match="not a folder of this user"):
        notes_folder()
    with announced(loop_named("a")):
        assert running_loops() == []
