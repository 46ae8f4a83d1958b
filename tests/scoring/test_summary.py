"""The lines that end a run: they fit a terminal, and make its point."""

from pathlib import Path

from protocol.runtime.run_folder import TAP_STATUS
from tests.support.small_run import SmallRun
from wyner.scoring.summary import render, summarise

PAYLOAD = b"two by two"


def test_the_lines_that_end_a_run_fit_a_terminal_of_80_columns(tmp_path: Path) -> None:
    """A tap that had it all was told in 82 columns, and the last two stood in a line alone."""
    run = SmallRun(tmp_path, (PAYLOAD,))
    run.until_received(1)
    run.close()
    summary = summarise(tmp_path, PAYLOAD)
    assert summary["delivered"]
    tap = {"symbol_accuracy": 1.0, "message_bit_accuracy": 1.0, "solved_k": 2563}
    summary |= {
        "run_dir": "runs/one",
        "true_bits": 0.0,
        "strongest": "set-membership",
        "taps": {
            "set-membership": {**tap, "messages_exact": 1},
            "list-decoder": {**tap, "messages_exact": 0},
        },
    }
    lines = render(summary).splitlines()
    assert max(map(len, lines)) <= 80
    assert any(line.endswith("100.0 % of message bits, whole") for line in lines)
    assert any(line.endswith("100.0 % of message bits, not whole") for line in lines)
    step = summary["delivered_k"]
    assert lines[-3] == f"The plant  had the message at step {step}."
    assert lines[-2].startswith("Eve        had it at step 2563, from what everyone can read")
    assert lines[-1].endswith("True: 0, measured (set-membership).")


def test_what_was_not_guessed_at_is_no_secret(tmp_path: Path) -> None:
    """On a full machine 12 % of the messages were left out, and counted as 2,199 bits kept."""
    run = SmallRun(tmp_path, (PAYLOAD,))
    run.until_received(1)
    run.close()
    (tmp_path / TAP_STATUS).parent.mkdir(exist_ok=True)
    (tmp_path / TAP_STATUS).write_text('{"unguessed":1234}')
    summary = summarise(tmp_path, PAYLOAD)
    assert summary["unguessed"] == 1234
    summary |= {"true_bits": 9.0, "strongest": "nearest-centre"}
    lines = render(summary).splitlines()
    assert "Eve        1234 messages waited too long to be guessed at live: wyner replay" in lines
    assert lines[-1].endswith("True: at most 9 (nearest-centre).")
