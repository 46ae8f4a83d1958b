"""The time that a design still takes: foreseen from growth, told in a pipe, refused in time."""

import math

import pytest

from controller_service.progress import LINES_S, Outlook, in_words, shown_progress
from controller_service.sets.terminal import SynthesisError


def outlook_after(sets: int, power: float) -> tuple[Outlook, float]:
    outlook, now = Outlook(0.0), 0.0
    for i in range(sets):
        now += (i + 1) ** power
        outlook.made(now)
    return outlook, now


@pytest.mark.parametrize("power", [0.0, 1.0, 3.0])
def test_growth_is_seen_and_carried_on(power: float) -> None:
    outlook, now = outlook_after(10, power)
    truth = sum((i + 1) ** power for i in range(10, 20))
    assert outlook.left_s(10) == pytest.approx(truth, rel=0.5)
    assert outlook.left_s(0) == 0
    assert math.isfinite(outlook.left_s(10**6))
    assert now > 0


def test_before_the_first_set_nothing_is_foreseen() -> None:
    assert Outlook(0.0).left_s(10) == 0


def test_a_design_that_takes_too_long_is_refused_with_what_would_do(
    capsys: pytest.CaptureFixture[str],
) -> None:
    now = 0.0
    with (
        pytest.raises(
            SynthesisError, match=r"30 sets would take about .* control\.horizon = (\d+)"
        ),
        shown_progress(60.0, lambda: now) as advance,
    ):
        for i in range(31):
            now += 0.01 * (i + 1) ** 3
            advance(i, 30)
    assert now < 40, "it is said in time"
    assert "wyner: sets: " in capsys.readouterr().err


def test_in_a_pipe_a_line_comes_every_ten_seconds(capsys: pytest.CaptureFixture[str]) -> None:
    now = 0.0
    with shown_progress(1000.0, lambda: now) as advance:
        for i in range(100):
            now += 0.5
            advance(i, 99)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == pytest.approx(50 / LINES_S, abs=1)
    assert all(" left" in line for line in lines)


def test_a_quick_design_is_quiet(capsys: pytest.CaptureFixture[str]) -> None:
    now = 0.0
    with shown_progress(60.0, lambda: now) as advance:
        for i in range(10):
            now += 0.01
            advance(i, 9)
    assert capsys.readouterr().err == ""


def test_times_in_words() -> None:
    assert [in_words(s) for s in (3, 89, 600, 7200)] == ["3 s", "89 s", "10 min", "2.0 h"]
