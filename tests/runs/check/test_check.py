"""wyner check: a right run passes, and each thing that is wrong fails the check that says so."""

import json
import shutil
from pathlib import Path

import pytest

from runtime.run_folder import CAPTURE, CONTROLLER_TRACE, GUESSES, PLANT_TRACE, SCENARIO
from runtime.shipped import SCENARIOS
from tests.support.checked_runs import failed, results_of
from tests.support.ended_run import ended_run
from tests.support.lines import unmarked
from tests.support.recorded_pair import Lines, RecordedPair, edit, read_lines, write_lines
from tests.support.traces import events_of
from wyner.cli.main import main
from wyner.runs.check import RULES, check
from wyner.runs.check.evidence import read_evidence

NAMES = [rule.name for rule in RULES]


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = RecordedPair(tmp_path_factory.mktemp("runs") / "clean", b"hi")
    run.until_received(1)
    run.steps(1)
    run.stop()
    return run.folder


@pytest.fixture
def copied(clean: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(clean, tmp_path / "run"))


# --- right runs -----------------------------------------------------------------------------------


def test_a_clean_run_passes_every_check(clean: Path) -> None:
    results = results_of(clean)
    assert {name for name, r in results.items() if r.result != "PASS"} == {"same-keys"}
    assert results["same-keys"].result == "SKIP"


@pytest.mark.parametrize(
    ("known", "received"), [(False, [b"one", b"one", b"two"]), (True, [b"one", b"two"])]
)
def test_a_message_that_was_whole_comes_again_if_the_controller_did_not_know(
    known: bool, received: list[bytes], tmp_path: Path
) -> None:
    """The plant loses its journal right after the last symbol, or a step later."""
    run = RecordedPair(tmp_path / "run", b"one", b"two")
    run.until_received(1)
    run.steps(int(known))
    run.step("plant forgets")
    run.until_received(len(received))
    run.stop()
    assert run.received == received
    assert failed(run.folder) == set()


def test_a_capture_may_have_parts(copied: Path) -> None:
    header, *lines, _end = read_lines(copied / CAPTURE)
    half = len(lines) // 2
    write_lines(copied / CAPTURE, [header, *lines[:half]])
    second = (copied / CAPTURE).with_name("capture.0001.jsonl")
    write_lines(second, [header | {"part": 1}, *lines[half:]])
    assert failed(copied) == set()
    del lines[half]
    write_lines(second, [header | {"part": 2}, *lines[half:]])
    assert failed(copied) == {"whole"}


def test_a_torn_end_is_no_failure(copied: Path) -> None:
    unmarked(copied)
    for name in (PLANT_TRACE, CONTROLLER_TRACE, CAPTURE):
        with (copied / name).open("ab") as file:
            file.write(b'{"event":"transition","session":"00')
    assert failed(copied) == set()
    assert [trace.marks.torn for trace in read_evidence(copied).ends()] == [1, 1]


@pytest.mark.parametrize(
    ("missing", "skipped"),
    [
        (CAPTURE, {"wire", "bus", "same-keys"}),
        (CONTROLLER_TRACE, {"in-step", "alarms", "same-keys"}),
    ],
)
def test_what_a_run_did_not_leave_is_skipped(
    copied: Path, missing: Path, skipped: set[str]
) -> None:
    shutil.rmtree((copied / missing).parent)
    results = results_of(copied)
    assert {name for name, r in results.items() if r.result == "SKIP"} == skipped
    assert failed(copied) == set()


# --- wrong runs -----------------------------------------------------------------------------------


def turn_the_coin(folder: Path) -> None:
    def change(lines: Lines) -> None:
        t = next(t for i, t in enumerate(lines) if i > 40 and t.get("symbol", -1) >= 0)
        t["coin"] = 1 - t["coin"]
        t["u"] = t["candidates"][t["coin"]]

    edit(folder / PLANT_TRACE, change)


def test_a_state_that_shows_on_the_bus_fails(copied: Path) -> None:
    """Public fields only, and yet the automaton state shows."""
    made = events_of(copied / PLANT_TRACE, "transition")
    carried = {t["k"] for t in made if t["role"] == "message"}

    def change(lines: Lines) -> None:
        for line in lines:
            if line.get("topic") == "offer" and line["message"]["k"] in carried:
                line["message"] = dict(reversed(line["message"].items()))

    edit(copied / CAPTURE, change)
    assert failed(copied) == {"bus", "whole"}


def test_a_changed_header_of_what_eve_heard_fails(copied: Path) -> None:
    """No end mark holds it: her guesses begin with the same header."""
    header = read_lines(unmarked(copied) / CAPTURE)[0]
    write_lines(copied / GUESSES, [header])
    assert failed(copied) == set()
    write_lines(copied / GUESSES, [header | {"view": {"loss": 0.125}}])
    assert failed(copied) == {"whole"}


def test_a_cipher_that_changed_before_it_was_applied_fails(tmp_path: Path) -> None:
    """The offer was lost on its way to the plant, but not to the tap: two ciphers, one key."""
    ended_run(tmp_path, (b"one", b"two"))
    k = next(e["k"] for e in read_lines(tmp_path / PLANT_TRACE) if e["event"] == "missed")

    def change(lines: Lines) -> None:
        offers = (line["message"] for line in lines if line.get("topic") == "offer")
        offer = next(message for message in offers if message["k"] == k)
        offer["cipher"] = 1 - offer["cipher"]

    edit(tmp_path / CAPTURE, change)
    assert failed(tmp_path) == {"wire", "whole"}


def test_a_run_in_which_nothing_happened_fails(tmp_path: Path) -> None:
    RecordedPair(tmp_path / "run", b"hi").stop()
    assert failed(tmp_path / "run") == {"traces"}


# --- the command ----------------------------------------------------------------------------------


def test_the_command_says_pass_or_fail_for_each_check(
    copied: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["check", str(copied)]
    assert main(command) == 0
    out = capsys.readouterr().out
    assert max(map(len, out.splitlines())) < 80
    lines = [line for line in out.splitlines() if not line.startswith(" ")]
    said = [["SKIP" if name == "same-keys" else "PASS", name] for name in NAMES]
    assert [line.split()[:2] for line in lines[:-1]] == said
    assert lines[-1] == f"{len(NAMES) - 1} PASS, 0 FAIL, 1 SKIP"
    assert main([*command, "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert (summary["passed"], summary["failed"], summary["skipped"]) == (True, 0, 1)
    assert [rule["name"] for rule in summary["rules"]] == NAMES
    turn_the_coin(copied)
    assert main(command) == 1
    out = capsys.readouterr().out
    assert "FAIL  paper" in out
    assert " first: session " in out
    assert main([*command, "--json"]) == 1
    summary = json.loads(capsys.readouterr().out)
    paper = next(rule for rule in summary["rules"] if rule["name"] == "paper")
    assert (paper["result"], summary["passed"]) == ("FAIL", False)
    assert paper["failures"] >= 1
    assert set(paper["first"]) == {"rule", "session", "k", "text"}


def test_no_run_is_one_line_and_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for _ in ("an empty folder", "a scenario alone"):
        assert main(["check", str(tmp_path)]) == 2
        err = capsys.readouterr().err
        assert err.startswith(f"wyner: {tmp_path}: no run here")
        assert len(err.splitlines()) == 1
        shutil.copy(SCENARIOS / "sustained.toml", tmp_path / SCENARIO)


@pytest.mark.parametrize(
    ("beginning", "said"),
    [
        (b"nothing of the kind\n", "line 1: not a JSON object"),
        (b'{"event":"missed"}\n', "line 1: expected a header"),
        (b'{"event":"continued"}\n', "line 1: expected a header"),
        (b'{"event":"header","format":"wyner-trace","version":1}\n', "line 1: version"),
        (b"[" * 100_000 + b"\n", "line 1: not a JSON object"),
    ],
)
def test_a_trace_without_its_header_fails_and_the_line_is_named(
    copied: Path, capsys: pytest.CaptureFixture[str], beginning: bytes, said: str
) -> None:
    (copied / PLANT_TRACE).write_bytes(beginning)
    assert main(["check", str(copied)]) == 1
    out, err = capsys.readouterr()
    assert said in out
    assert "PASS" in out
    assert err == ""


def test_a_service_that_was_killed_before_its_first_line_is_honest(copied: Path) -> None:
    for trace in (PLANT_TRACE, CONTROLLER_TRACE):
        (copied / trace).write_bytes(b"")
    found = check(read_evidence(copied))
    assert all("journal" in f.text for f in found if f.rule == "whole")
    assert "header" not in str(found)
