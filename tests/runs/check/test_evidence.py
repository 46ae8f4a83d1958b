"""What is evidence cannot change unseen; what is none may. Both are said of every file of a run."""

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from runtime.run_folder import CAPTURE, MANIFEST, SUMMARY
from tests.support.checked_runs import failed
from wyner.runs.check import check
from wyner.runs.check.evidence import read_evidence
from wyner.runs.seal import READ, broken, evidence_below

pytestmark = [pytest.mark.slow, pytest.mark.integration]


@pytest.fixture
def unsealed(copied: Path) -> Path:
    """As if everything had been killed before it was summed up."""
    (copied / SUMMARY).unlink()
    manifest = json.loads((copied / MANIFEST).read_bytes())
    del manifest["files"], manifest["manifest"]
    (copied / MANIFEST).write_text(json.dumps(manifest))
    return copied


def passes(folder: Path) -> bool:
    """A folder that is no run any more does not pass."""
    try:
        return not failed(folder)
    except Exception as error:
        assert type(error).__name__ in ("ScenarioError", "FileNotFoundError"), error
        return False


def seal_says(folder: Path) -> list[str]:
    """Which files the seal finds otherwise; it is a quick part of the check."""
    try:
        manifest = json.loads((folder / MANIFEST).read_bytes())
    except (OSError, ValueError):
        return []
    return [name for name, wrong in broken(folder, manifest) if wrong]


def emptied(path: Path) -> None:
    os.truncate(path, 0)


def truncated(path: Path) -> None:
    os.truncate(path, path.stat().st_size * 3 // 4)


def one_record_changed(path: Path) -> None:
    """A digit in the middle."""
    raw = bytearray(path.read_bytes() or b"0")
    digits = [i for i in range(len(raw)) if chr(raw[i]).isdigit()]
    at = digits[len(digits) // 2] if digits else len(raw) // 2
    raw[at] ^= 1
    path.write_bytes(raw)


CHANGES: tuple[Callable[[Path], None], ...] = (
    Path.unlink,
    emptied,
    truncated,
    one_record_changed,
)


def test_an_honest_run_passes_without_its_seal_too(unsealed: Path) -> None:
    assert failed(unsealed) == set()


def test_every_file_that_a_run_leaves_is_evidence(run: Path) -> None:
    left = {path for path in run.rglob("*") if path.is_file()} - {*evidence_below(run)}
    none = {path for path in left if path.name in ("lock", "log.old") or path.name[0] == "."}
    assert left == none


def same(before: Path, after: Path) -> bool:
    """Whether a change left a file as it was, as where an empty one is emptied."""
    return after.exists() and after.read_bytes() == before.read_bytes()


@pytest.mark.parametrize("how", CHANGES)
def test_no_evidence_changes_unseen(run: Path, tmp_path: Path, how: Callable[[Path], None]) -> None:
    for path in evidence_below(run):
        name = path.relative_to(run)
        folder = Path(shutil.copytree(run, tmp_path / "copy"))
        how(folder / name)
        if not same(path, folder / name):
            assert seal_says(folder) or not passes(folder), f"{name}: {how.__name__}"
        shutil.rmtree(folder)


SAID = {"tap/guesses.jsonl", "tap/analysis.jsonl"}
"""What she said: a writer that is killed leaves as little, and no end mark."""

KEPT = {"plant/journal.sqlite3", "controller/journal.sqlite3"}

UNSEEN: dict[Callable[[Path], None], set[str]] = {
    Path.unlink: {*SAID, *KEPT, MANIFEST.name, "tap/status.json"},
    emptied: SAID,
    truncated: SAID,
    one_record_changed: {*SAID, "tap/status.json"},  # a smaller count of the capture, her clock
}
"""What may be so where no seal holds it."""


@pytest.mark.parametrize("how", CHANGES)
def test_without_a_seal_the_checks_see_what_they_are_said_to(
    unsealed: Path, tmp_path: Path, how: Callable[[Path], None]
) -> None:
    unseen = set()
    for path in {path for pattern in READ for path in unsealed.glob(pattern)}:
        name = path.relative_to(unsealed)
        folder = Path(shutil.copytree(unsealed, tmp_path / "copy"))
        how(folder / name)
        if path.read_bytes() and not same(path, folder / name) and passes(folder):
            unseen.add(str(name))
        shutil.rmtree(folder)
    assert unseen <= UNSEEN[how]


@pytest.mark.parametrize("how", CHANGES)
def test_what_is_no_evidence_is_free(
    run: Path, tmp_path: Path, how: Callable[[Path], None]
) -> None:
    folder = Path(shutil.copytree(run, tmp_path / "copy"))
    evidence = evidence_below(folder)
    for path in folder.rglob("*"):
        if path.is_file() and path not in evidence:
            how(path)
    assert failed(folder) == set()


@pytest.mark.parametrize("field", ["loop", "knowledge", "view", "eavesdroppers", "appearances"])
def test_a_change_of_the_captures_header_is_named(unsealed: Path, field: str) -> None:
    """Also where the tap was killed, so that no end mark holds it."""
    head, *lines = (unsealed / CAPTURE).read_bytes().splitlines(keepends=True)
    header = json.loads(head) | {field: None}
    kept = [line for line in lines if b'"event":"end"' not in line]
    (unsealed / CAPTURE).write_bytes(head + b"".join(kept))
    assert not failed(unsealed)
    (unsealed / CAPTURE).write_bytes(json.dumps(header).encode() + b"\n" + b"".join(kept))
    told = [f.text for f in check(read_evidence(unsealed)) if f.rule == "whole"]
    assert any(text.endswith(f"their headers differ in {field}") for text in told)
