"""Traces in parts: read in order, honest about parts that are gone, by the writer or another."""

import json
import shutil
from pathlib import Path

import pytest

from runtime.recording import Bounds, parts_of
from runtime.run_folder import BELIEFS, CONTROLLER_TRACE, PLANT_TRACE
from tests.support.checked_runs import failed, results_of
from tests.support.recorded_pair import RecordedPair, read_lines, write_lines
from tests.support.traces import events_of
from wyner.cli.main import main
from wyner.runs.check.evidence import read_evidence

PART = 40_000


def made(folder: Path, bounds: Bounds) -> Path:
    """Two messages, kills, losses and a lost journal, whatever the bounds the same."""
    run = RecordedPair(folder, b"one", b"two", b"three", bounds=bounds)
    for number in range(8):
        faults = {5: "repeated", 9: "offer lost", 20 + number: "plant dies", 41: "controller dies"}
        run.steps(60, faults)  # type: ignore[arg-type]
    run.step("controller forgets")
    run.until_received(3)
    run.steps(200, {7: "offer lost", 150: "plant dies"})
    run.stop()
    return folder


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made(tmp_path_factory.mktemp("runs") / "whole", Bounds())


@pytest.fixture(scope="module")
def parted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made(tmp_path_factory.mktemp("runs") / "parted", Bounds(part_bytes=PART))


@pytest.fixture(scope="module")
def bounded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    bounds = Bounds(part_bytes=PART, total_bytes=5 * PART)
    return made(tmp_path_factory.mktemp("runs") / "bounded", bounds)


@pytest.fixture
def copied(parted: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(parted, tmp_path / "run"))


@pytest.mark.slow
def test_parts_hold_what_one_file_would(whole: Path, parted: Path) -> None:
    for path in (PLANT_TRACE, CONTROLLER_TRACE):
        assert len(parts_of(parted / path)) > 5
        left, right = (events_of(folder / path, "transition") for folder in (parted, whole))
        assert [e | {"session": ""} for e in left] == [e | {"session": ""} for e in right]
    for one, many in zip(read_evidence(whole).ends(), read_evidence(parted).ends(), strict=True):
        assert one.rows.tobytes() == many.rows.tobytes()
        assert len(many.parts) > len(one.parts) == 1
    assert failed(parted) == set()


def test_what_a_bounded_trace_has_left_is_judged_and_the_rest_is_not(
    whole: Path, bounded: Path
) -> None:
    left = results_of(bounded)
    assert failed(bounded) == set()
    assert "of the plant's trace are gone, judged after transition" in left["traces"].note
    for name in ("traces", "plant", "replay", "in-step", "paper"):
        assert left[name].result == "PASS"
    for one, cut in zip(read_evidence(whole).ends(), read_evidence(bounded).ends(), strict=True):
        assert 0.1 < len(cut.rows) / len(one.rows) < 0.7


@pytest.mark.slow
def test_a_side_that_begins_later_is_compared_from_there_on(parted: Path, copied: Path) -> None:
    """One side cut, as its writer would have: its newest header says so."""
    for path in (PLANT_TRACE, CONTROLLER_TRACE):
        shutil.rmtree(copied)
        shutil.copytree(parted, copied)
        _cut_off(copied / path, 4)
        assert failed(copied) == set()
        assert results_of(copied)["in-step"].result == "PASS"


def test_a_wrong_number_in_what_is_left_fails(bounded: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(bounded, tmp_path / "run"))
    part = parts_of(folder / PLANT_TRACE)[-2]
    lines = read_lines(part)
    at = max(i for i, line in enumerate(lines) if line.get("role") == "message")
    lines[at]["message_symbol"] ^= 1
    write_lines(part, lines)
    assert {"replay", "in-step", "whole"} <= failed(folder)


@pytest.mark.parametrize("number", [0, 1, 3, -1])
def test_a_part_that_the_writer_did_not_drop_is_missed(copied: Path, number: int) -> None:
    parts_of(copied / CONTROLLER_TRACE)[number].unlink()
    # what a deleted newest part leaves looks like a kill: the other side has gone on
    assert ("in-step" if number == -1 else "whole") in failed(copied)


def test_a_trace_of_which_nothing_can_be_judged_passes_nothing(copied: Path) -> None:
    for path in (PLANT_TRACE, CONTROLLER_TRACE):
        _cut_off(copied / path, len(parts_of(copied / path)) - 1)
        newest = parts_of(copied / path)[-1]
        lines = read_lines(newest)
        write_lines(newest, lines[:1])  # its header, and killed
    found = results_of(copied)
    assert "PASS" not in {found[name].result for name in ("plant", "in-step", "replay")}
    assert found["traces"].result == "SKIP"


def _cut_off(path: Path, count: int) -> None:
    parts = parts_of(path)
    for part in parts[:count]:
        part.unlink()
    newest = parts[-1]
    lines = newest.read_bytes().splitlines(keepends=True)
    header = json.loads(lines[0])
    header["oldest"] = count
    ended = json.loads(lines[-1])["event"] == "end"
    newest.write_bytes(
        json.dumps(header, separators=(",", ":")).encode()
        + b"\n"
        + b"".join(lines[1 : -1 if ended else None])
    )


def test_a_score_says_where_the_plants_trace_was_cut(
    copied: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = "the plant's trace has no end: it runs still, was killed, or the file was cut"
    newest = parts_of(copied / PLANT_TRACE)[-1]
    whole = newest.read_bytes()
    (copied / BELIEFS).parent.mkdir(exist_ok=True)
    (copied / BELIEFS).write_text("{}")
    for cut in (0, 1, 20, len(whole.splitlines(keepends=True)[-1])):
        newest.write_bytes(whole[: len(whole) - cut])
        assert main(["score", str(copied)]) == 0
        assert (said in capsys.readouterr().err) == (cut > 0)
