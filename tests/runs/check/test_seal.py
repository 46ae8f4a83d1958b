"""Nothing in a run's folder changes after the run without the check naming the file."""

import contextlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from protocol.scenario import ScenarioError
from runtime.files import write_atomically
from runtime.recording import LineWriter
from runtime.run_folder import (
    BELIEFS,
    CONTROLLER_JOURNAL,
    CONTROLLER_STATUS,
    KNOWLEDGE,
    MANIFEST,
    MESSAGE,
    PLANT_JOURNAL,
    PLANT_STATUS,
    PLANT_TRACE,
    SCENARIO,
    SUMMARY,
    TAP_STATUS,
)
from runtime.scenario_file import load_scenario
from tests.support.checked_runs import failed
from tests.support.recorded_pair import make_run
from wyner.cli.main import main
from wyner.runs.check import check
from wyner.runs.check.evidence import read_evidence
from wyner.runs.seal import READ, SEAL_ALONE, broken, evidence_below, seal

LOG = Path("plant/log")


def put(run: Path, name: Path, content: Any) -> None:
    write_atomically(run / name, json.dumps(content).encode())


@pytest.fixture(scope="module")
def sealed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = tmp_path_factory.mktemp("runs") / "sealed"
    make_run(run, 60)
    for name in (CONTROLLER_STATUS, PLANT_STATUS, BELIEFS, SUMMARY, KNOWLEDGE, MESSAGE, LOG):
        put(run, name, {"k": 60})
    put(run, TAP_STATUS, {"t_ns": 0, "first_part": 0, "captured": 120, "dropped": 0})
    identity = load_scenario(run / SCENARIO).identity()
    put(run, MANIFEST, {"wyner": "0", "seed": None, "command": ["up"], **identity})
    seal(run)
    return run


@pytest.fixture
def run(sealed: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(sealed, tmp_path / "run"))


def wrong(run: Path) -> dict[str, str]:
    manifest = json.loads((run / MANIFEST).read_bytes()) if (run / MANIFEST).exists() else None
    return dict(broken(run, manifest))


def test_an_honest_run_passes_and_a_table_that_is_made_later_is_none_of_it(run: Path) -> None:
    assert failed(run) == set()
    (run / "plant" / "steps.csv").write_text("made later")
    assert wrong(run) == {}
    assert failed(run) == set()


def emptied(path: Path) -> None:
    os.truncate(path, 0)


def truncated(path: Path) -> None:
    os.truncate(path, path.stat().st_size * 3 // 4)


def one_record_changed(path: Path) -> None:
    """A digit in the middle, or another byte."""
    raw = bytearray(path.read_bytes())
    digits = [i for i, byte in enumerate(raw) if chr(byte).isdigit()]
    raw[digits[len(digits) // 2] if digits else len(raw) // 2] ^= 1
    path.write_bytes(raw)


UNSEEN: dict[Callable[[Path], None], set[Path]] = {
    Path.unlink: {MANIFEST, TAP_STATUS, CONTROLLER_JOURNAL, PLANT_JOURNAL},
    emptied: set(),
    truncated: set(),
    one_record_changed: {TAP_STATUS},  # a smaller count of the capture, or another time
}
"""What may be so where no seal holds it."""


@pytest.mark.parametrize("how", UNSEEN)
def test_no_evidence_changes_unseen(run: Path, how: Callable[[Path], None]) -> None:
    """The seal holds all of it, and without one the rules what they are said to read."""
    for path in evidence_below(run):
        before = path.read_bytes()
        how(path)
        found = {} if path == run / MANIFEST else wrong(run)
        assert str(path.relative_to(run)) in found or not passes(run), path
        path.write_bytes(before)
    unseal(run)
    (run / SUMMARY).unlink()
    assert failed(run) == set()
    for path in {path for pattern in READ for path in run.glob(pattern)}:
        before = path.read_bytes()
        how(path)
        assert path.relative_to(run) in UNSEEN[how] or not passes(run), path
        path.write_bytes(before)


def passes(run: Path) -> bool:
    """A folder that is no run any more does not pass."""
    try:
        return not failed(run)
    except (ScenarioError, FileNotFoundError):
        return False


def unseal(run: Path) -> None:
    manifest = json.loads((run / MANIFEST).read_bytes())
    del manifest["files"], manifest["manifest"]
    put(run, MANIFEST, manifest)


def test_looking_at_a_run_writes_nothing_in_its_folder(run: Path) -> None:
    def listing() -> dict[Path, tuple[int, bytes]]:
        files = (path for path in run.rglob("*") if path.is_file())
        return {path: (path.stat().st_mtime_ns, path.read_bytes()) for path in files}

    before = listing()
    for gone in (None, LOG, PLANT_TRACE, CONTROLLER_JOURNAL):
        if gone is not None:
            (run / gone).unlink()
            del before[run / gone]
        check(read_evidence(run))
        assert listing() == before


class Death(BaseException):
    """The process is killed here."""


@pytest.mark.parametrize("at", range(6))
def test_a_run_that_is_killed_while_it_is_sealed_passes(
    run: Path, monkeypatch: pytest.MonkeyPatch, at: int
) -> None:
    """Before or after any write or change of name: sealed, or as if killed altogether."""
    (run / SUMMARY).unlink()
    unseal(run)
    calls = 0
    replace = Path.replace

    def mortal(path: Path, target: Path) -> Path:
        nonlocal calls
        if calls == at:
            raise Death
        replace(path, target)
        calls += 2
        if calls == at + 1:
            raise Death
        return target

    monkeypatch.setattr(Path, "replace", mortal)
    with contextlib.suppress(Death):
        seal(run, b'{"delivered": true}')
    monkeypatch.undo()
    assert wrong(run) == {}
    assert failed(run) == set()


def test_a_service_that_was_started_again_since_is_held_to_what_it_had_recorded(run: Path) -> None:
    """Its journal and status are new; its recording still begins as it was sealed."""
    lines = LineWriter(run / PLANT_TRACE, {})
    lines.append(b'{"event":"session","session":null,"reason":"started"}')
    lines.close()
    put(run, PLANT_STATUS, {"k": 61})
    assert wrong(run) == {}
    put(run, CONTROLLER_STATUS, {"k": 61})
    assert wrong(run) == {str(CONTROLLER_STATUS): "it is not as the run left it"}
    raw = (run / PLANT_TRACE).read_bytes()
    (run / PLANT_TRACE).write_bytes(raw.replace(b'"k":7,', b'"k":8,', 1))
    assert str(PLANT_TRACE) in wrong(run)


def test_a_run_that_goes_on_is_refused_in_a_line(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Read while it was written, an honest run failed eight checks."""
    code = (
        "import sys, pathlib\n"
        "from runtime.journal import PlantJournal\n"
        "journal = PlantJournal(pathlib.Path(sys.argv[1]), 'sustained')\n"
        "print('held', flush=True); sys.stdin.read()\n"
    )
    held = run / "again" / PLANT_JOURNAL
    held.parent.mkdir(parents=True)
    folder = str(run / "again")
    with subprocess.Popen(
        [sys.executable, "-c", code, str(held)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as writer:
        assert writer.stdout is not None
        assert writer.stdout.readline() == b"held\n"
        for command in ("check", "report"):
            assert main([command, folder]) == 2
            said = capsys.readouterr()
            assert (said.out, said.err.count("\n")) == ("", 1)
            assert "plant still at work, expected a run that has ended" in said.err
        writer.kill()
        writer.wait()
    main(["check", folder])
    assert "at work" not in capsys.readouterr().err


def test_a_seal_that_is_gone_is_missed(run: Path) -> None:
    unseal(run)
    assert wrong(run) == {"manifest.json": "the run was summed up, and its seal is gone"}
    (run / MANIFEST).unlink()
    assert "whole" in failed(run)
    (run / SUMMARY).unlink()  # killed as a whole
    assert wrong(run) == {}


def test_check_says_which_files_are_evidence(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(run), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["sealed"]
    assert told["files"] == [*READ, *SEAL_ALONE]
