"""What somebody sees who waits for a design, and when it is refused."""

import sys

import pytest

from controller_service.progress import shown_progress
from controller_service.sets.terminal import SynthesisError
from runtime.progress import shown


def test_a_design_that_takes_too_long_is_refused_with_what_would_do(
    capsys: pytest.CaptureFixture[str],
) -> None:
    now = 0.0
    refused = r"12 of 30 sets took 61 s, .* control\.horizon = 12 would do, or .* wyner\.design"
    with (
        pytest.raises(SynthesisError, match=refused),
        shown_progress(lambda: now, lambda: now) as advance,
    ):
        for i in range(31):
            now += 0.1 * i**2 if i < 12 else 10.2
            advance(i, 30)
    assert "wyner: sets: " in capsys.readouterr().err


def test_on_a_terminal_a_line_changes_and_is_gone_in_the_end(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    now = 0.0
    with shown_progress(lambda: now, lambda: now) as advance:
        for i in range(4):
            now += 0.6
            advance(i, 3)
    *shown_lines, last, empty = capsys.readouterr().err.split("\r")
    assert [text.strip() for text in shown_lines] == [
        f"wyner: sets: {i} of 3 after {t} s, at least {left} s left"
        for i, t, left in ((1, 1, 2), (2, 2, 1), (3, 2, 0))
    ]
    assert last.strip() == empty == ""


def test_a_busy_machine_makes_no_design_too_large() -> None:
    """A shipped one was refused after 60 s in which it had computed for 11."""
    waited = 0.0
    with shown_progress(lambda: waited, lambda: waited / 10) as advance:
        for i in range(8):
            advance(i, 8)
            waited += 60.0


def test_sets_that_are_all_made_are_not_refused() -> None:
    """The last one once was: "8 are made", and the advice was a horizon of 8."""
    now = 0.0
    with shown_progress(lambda: now, lambda: now) as advance:
        for i in range(8):
            advance(i, 8)
        now = 76.0
        advance(8, 8)


def test_work_that_is_resumed_is_estimated_by_its_own_pace(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Half of it was there: what is left takes as long as the pace since says."""
    now = 0.0
    with shown("runs", clock=lambda: now) as advance:
        advance(500, 1000)
        now = 10.0
        advance(600, 1000)
    assert capsys.readouterr().err == "wyner: runs: 600 of 1000 after 10 s, about 40 s left\n"
