"""The time that a design still takes: foreseen from growth, told in a pipe, refused in time."""

import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from controller_service.progress import LINES_S, Forecast, in_words, shown_progress
from controller_service.sets.terminal import SynthesisError

PENDULUM = (
    (8, 20, 60, 178, 474, 1086, 2226, 4376, 8094, 14446, 24416, 40478, 64652),
    (0.0, 0.001, 0.011, 0.016, 0.03, 0.071, 0.202, 0.39, 0.888, 1.922, 4.044, 7.687, 13.71),
)
"""Facets of T_0 to T_12 of the textbooks' pendulum, and when each was done, as measured."""


def polytope(facets: int, states: int = 4) -> Any:
    return SimpleNamespace(H=np.zeros((1, states)), h=range(facets))


def test_the_time_left_is_foreseen_within_a_factor_of_two_and_a_half() -> None:
    outlook = Forecast(0.0)
    for i, (facets, done_s) in enumerate(zip(*PENDULUM, strict=True)):
        outlook.made(done_s, facets, 4)
        left, truth = outlook.left_s(12 - i), PENDULUM[1][-1] - done_s
        if i < 12:
            assert truth / 2.5 < left < 2.5 * truth, i


def test_sets_that_stop_growing_take_the_same_time_each() -> None:
    outlook = Forecast(0.0)
    for i, facets in enumerate((8, 40, 120, 300, 500, 600, 600, 590, 580, 580, 580)):
        outlook.made(0.1 * i, facets, 4)
    assert outlook.left_s(100) == pytest.approx(10.0, rel=0.1)


@pytest.mark.parametrize("power", [1.0, 2.0, 4.0])
def test_growth_is_seen_and_carried_on(power: float) -> None:
    outlook, now = Forecast(0.0), 0.0
    for i in range(1, 20):
        now += 0.1 * i**power
        outlook.made(now, round(10 * i**power), 5)
    truth = sum(0.1 * i**power for i in range(20, 40))
    assert outlook.left_s(20) == pytest.approx(truth, rel=0.35)
    assert outlook.left_s(0) == 0


def test_two_states_are_no_matter_and_nothing_is_known_before_t_0() -> None:
    outlook = Forecast(0.0)
    assert outlook.left_s(10) == 0
    outlook.made(0.0, 4, 2)
    assert outlook.left_s(250) == 0


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
            advance(i, 30, polytope(8 * (i + 1) ** 3))
    assert now < 40, "it is said in time"
    assert "wyner: sets: " in capsys.readouterr().err


def test_in_a_pipe_a_line_comes_every_ten_seconds(capsys: pytest.CaptureFixture[str]) -> None:
    now = 0.0
    with shown_progress(1000.0, lambda: now) as advance:
        for i in range(100):
            now += 0.5
            advance(i, 99, polytope(4, 2))
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == pytest.approx(50 / LINES_S, abs=1)
    assert all(" left" in line for line in lines)


def test_sets_that_are_all_made_are_not_refused() -> None:
    """The last one once was: "8 are made", and the advice was a horizon of 8."""
    now = 0.0
    with shown_progress(60.0, lambda: now) as advance:
        for i in range(8):
            advance(i, 8, polytope(4, 2))
        now = 76.0
        advance(8, 8, polytope(4, 2))


def test_a_quick_design_is_quiet(capsys: pytest.CaptureFixture[str]) -> None:
    now = 0.0
    with shown_progress(60.0, lambda: now) as advance:
        for i in range(10):
            now += 0.01
            advance(i, 9, polytope(4, 2))
    assert capsys.readouterr().err == ""


def test_times_in_words() -> None:
    assert [in_words(s) for s in (3, 89, 600, 7200)] == ["3 s", "89 s", "10 min", "2.0 h"]


def test_an_estimate_comes_before_the_work(capsys: pytest.CaptureFixture[str]) -> None:
    with shown_progress(60.0, lambda: 0.0) as advance:
        advance(0, 10, polytope(8))
    (line,) = capsys.readouterr().err.splitlines()
    assert re.fullmatch(r"wyner: 10 sets of 4 states: about \d s, by plants of that size", line)
