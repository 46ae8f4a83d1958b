"""The lines that end a run: they fit a terminal, and make its point."""

import base64
import json
import shutil
from pathlib import Path

import pytest

from runtime.run_folder import BELIEFS, PLANT_TRACE, TAP_STATUS
from tap_service.status import absent
from tests.support.recorded_pair import RecordedPair
from wyner.runs.run import Run
from wyner.runs.score.score import SILENT, UNFINISHED
from wyner.runs.score.summary import AGAIN, render, summarise

PAYLOAD = b"two by two"

TAP = {
    "symbols_known": 1.0, "unused": {}, "message_bit_accuracy": 1.0, "messages_exact": 0,
    "solved_k": -1, "failed": "", "unscored": "", "stray_steps": 0, "steps_not_looked_at": 0,
}  # fmt: skip
"""What a summary says of an eavesdropper, as far as its lines need it."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that ends with its message."""
    run = RecordedPair(tmp_path_factory.mktemp("runs") / "whole", PAYLOAD)
    run.until_received(1)
    run.stop()
    return run.folder


@pytest.fixture
def folder(whole: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(whole, tmp_path / "run"))


def test_the_lines_that_end_a_run_fit_a_terminal_of_80_columns(folder: Path) -> None:
    """A tap that had it all was told in 82 columns, and the last two stood in a line alone."""
    summary = summarise(Run.load(folder), PAYLOAD)
    assert summary["delivered"]
    summary |= {
        "run_dir": "runs/one",
        "true_bits": 0.0,
        "strongest": "set-membership",
        "taps": {
            "set-membership": TAP | {"messages_exact": 1, "solved_k": 2563},
            "list-decoder": TAP | {"steps_not_looked_at": 17},
            "nearest-centre": TAP | {"stray_steps": 1234},
            "key-solver": TAP | {"unscored": SILENT},
            "text": TAP | {"unscored": UNFINISHED},
        },
    }
    lines = render(summary).splitlines()
    assert max(map(len, lines)) <= 80
    for told in (
        "100.0 % of bits, whole",
        "100.0 % of bits, not whole",
        # each symbol of the message is right, and others stand between them: no frame fits
        "100.0 % of bits, 1234 bits too many",
        f"not scored: {SILENT}",
        f"not scored: {UNFINISHED}: {AGAIN}",
        f"17 steps not read yet: {AGAIN}",
    ):
        assert any(line.endswith(told) for line in lines), told
    summary["taps"]["nearest-centre"]["stray_steps"] = 1
    assert "100.0 % of bits, 1 bit too many\n" in render(summary)
    early = render(summary | {"messages": 0}).splitlines()
    assert any(line.endswith("100.0 % of bits, none was whole yet") for line in early)
    step = summary["delivered_k"]
    assert lines[-3] == f"The plant  had the message at step {step}."
    assert lines[-2].startswith("Eve        had it at step 2563, from what everyone can read")
    assert "by the paper's rule" in lines[-1]
    assert "the paper claims" not in "\n".join(lines)
    assert lines[-1].endswith("True: at most 0 (set-membership).")


def test_true_is_told_with_all_that_it_rests_on(folder: Path) -> None:
    """An entropy given English stood there as if it needed no expectation, and a tap that used a
    tenth of the steps as if it had used all.
    """
    counts = dict.fromkeys(("foreign", "late", "dropped", "jumped", "restarts"), 12345)
    summary = summarise(Run.load(folder), PAYLOAD) | {
        "run_dir": "runs/one",
        "claimed_bits": 638.0,
        "true_bits": 12.0,
        "true_bits_stated": 12.0,
        "true_bits_by_keys": 15.0,
        "given": "English sentences",
        "labels": [1, 0],
        "silent_bits": 608.0,
        "silent_steps": 304,
        "strongest": "text",
        "taps": {"text": TAP | {"unused": counts}},
    }
    text = render(summary)
    lines = text.splitlines()
    assert max(map(len, lines)) <= 80
    assert lines[-5:] == [
        "Secret     638 bits by the paper's rule. True: at most 12 of 30 (text).",
        "           At most 12 given English sentences; by keys alone at most 15.",
        "           Eve's symbols count relabelled: 0 is 1, 1 is 0.",
        "           The other 608 bits are not known to be secret:",
        "           Eve could not use 304 agreed steps.",
    ]
    words = " ".join(text.split())
    assert "Eve text not used: 12345 messages of other sessions, 12345 late messages" in words
    assert "12345 restarts" in words


def test_a_tap_that_failed_is_told_in_the_last_lines(folder: Path) -> None:
    record = absent("mine")[1] | {"failed": "step 21: ValueError: no idea", "steps": 21}
    (folder / BELIEFS).parent.mkdir(exist_ok=True)
    (folder / BELIEFS).write_text(json.dumps({"mine": record}))
    summary = summarise(Run.load(folder), PAYLOAD)
    assert summary["true_bits"] is None
    assert summary["failed"] == ["mine"]
    lines = render(summary).splitlines()
    assert "Eve        mine            FAILED: not scored" in lines
    assert lines[-2].endswith("bits by the paper's rule. True: unknown, Eve failed.")
    assert lines[-1] == "FAILED     mine: step 21: ValueError: no idea"
    record |= {"failed": ""}
    # killed while she was behind: what she leaves is unknown, whatever she had guessed by then
    for symbols, why in ((None, UNFINISHED), ([], "nobody guessed")):
        (folder / BELIEFS).write_text(json.dumps({"mine": record | {"symbols": symbols}}))
        summary = summarise(Run.load(folder), PAYLOAD)
        assert summary["failed"] == []
        assert render(summary).splitlines()[-1].endswith(f"True: unknown, {why}.")


def test_what_was_not_guessed_at_is_no_secret(folder: Path) -> None:
    """On a full machine 12 % of the messages were left out, and counted as 2,199 bits kept."""
    (folder / TAP_STATUS).parent.mkdir(exist_ok=True)
    (folder / TAP_STATUS).write_text('{"unguessed":1234}')
    summary = summarise(Run.load(folder), PAYLOAD)
    assert summary["unguessed"] == 1234
    summary |= {"true_bits": 9.0, "strongest": "nearest-centre"}
    lines = render(summary).splitlines()
    assert f"Eve        1234 messages were not guessed at live: {AGAIN}" in lines
    assert lines[-1].endswith("True: at most 9 (nearest-centre).")


def test_each_message_is_told_beside_itself(tmp_path: Path) -> None:
    """The first that was sent stood beside the last that was recovered."""
    run = RecordedPair(tmp_path, PAYLOAD, b"second", b"third")
    run.until_received(2)
    run.stop()
    summary = summarise(Run.load(tmp_path), PAYLOAD)
    assert (summary["sent"], summary["recovered"]) == ("two by two", "two by two")
    assert summary["messages"] == 2
    pairs = {base64.b64decode(p["sent_base64"]): p["recovered_k"] for p in summary["exchanged"]}
    assert list(pairs) == [PAYLOAD, b"second", b"third"]
    assert 0 <= pairs[PAYLOAD] == summary["delivered_k"] < pairs[b"second"]
    assert pairs[b"third"] == -1
    lines = render(summary).splitlines()
    assert f"besides    'second', recovered at step {pairs[b'second']}" in lines
    assert "besides    'third', not recovered" in lines


def test_a_plant_that_lost_its_journal_has_made_all_its_steps(tmp_path: Path) -> None:
    """Its second life counts from 0 again: the rate was told up to twice too large."""
    run = RecordedPair(tmp_path, PAYLOAD)
    run.steps(200, {100: "plant forgets", 30: "plant dies", 150: "plant dies"})
    run.stop()
    summary = summarise(Run.load(tmp_path), PAYLOAD)
    assert summary["steps"] == 200
    assert summary["missed"] == 200 - summary["transitions"]
    assert summary["bits_per_second"] == pytest.approx(summary["bits"] / 20.0)


@pytest.mark.parametrize(("line", "steps"), [(0, 0), (3, None)])
def test_a_trace_that_is_damaged_is_told(tmp_path: Path, line: int, steps: int | None) -> None:
    run = RecordedPair(tmp_path, PAYLOAD)
    run.steps(20)
    run.stop()
    trace = tmp_path / PLANT_TRACE
    lines = trace.read_bytes().splitlines(keepends=True)
    lines[line] = b'{"event":"transition"}\n'
    trace.write_bytes(b"".join(lines))
    summary = summarise(Run.load(tmp_path), PAYLOAD)
    assert str(trace.name) in summary["trace_error"]
    assert steps is None or summary["steps"] == steps
    assert any(one.startswith("trace      damaged") for one in render(summary).splitlines())
