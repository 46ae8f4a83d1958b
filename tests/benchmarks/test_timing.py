"""The timing test sees what it must, and nothing where there is nothing."""

import random
from pathlib import Path

import pytest

from benchmarks.check import make_run
from benchmarks.timing import (
    SIDES,
    Answers,
    bus_times,
    difference,
    measure,
    recorded,
    render,
    response_times,
)
from benchmarks.work import work
from controller_service import core
from tests.support.broken import broken


def times(seed: int, count: int, longer: float = 0.0) -> Answers:
    """A service's answers: about 80 us, now and then much longer, and slower from time to time."""
    draw = random.Random(seed)
    return [
        (
            i % 2 == 1,
            (1.5 if i // 500 % 2 else 1.0) * (80_000 + draw.gauss(0, 4000))
            + (longer if i % 2 else 0.0)
            + (1e6 if draw.random() < 0.02 else 0),
        )
        for i in range(count)
    ]


def test_a_microsecond_is_seen_and_noise_is_not() -> None:
    assert not any(difference(times(s, 6000)).seen for s in range(20))
    found = [difference(times(s, 6000, 1000.0)) for s in range(20)]
    assert all(one.seen for one in found)
    assert sum(one.ns for one in found) / 20 == pytest.approx(1000, abs=100)


def test_the_standard_error_is_the_differences_own_spread() -> None:
    found = [difference(times(s, 1000)) for s in range(200)]
    spread = (sum(one.ns**2 for one in found) / 200) ** 0.5
    mean_error = sum(one.error_ns for one in found) / 200
    assert spread == pytest.approx(mean_error, rel=0.15)


def test_too_few_values_are_refused() -> None:
    with pytest.raises(ValueError, match="ten blocks"):
        difference(times(1, 399 - 40))
    with pytest.raises(ValueError, match="got 0"):
        difference([(False, 1.0)] * 1000)


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["sustained", "keys"])
def test_both_ends_answers_are_timed_in_both_states(scenario: str, tmp_path: Path) -> None:
    lives = recorded(200, scenario, tmp_path)
    for side in SIDES:
        found = response_times(side, scenario, lives[side], added_ns=300_000)
        times_of = [sorted(ns for c, ns in found if c == carries) for carries in (False, True)]
        assert times_of[1][0] >= 300_000 > times_of[0][len(times_of[0]) // 2]
        assert len(found) >= 150


def test_a_runs_capture_has_the_times_of_both_ends(tmp_path: Path) -> None:
    make_run(tmp_path, 60)
    found = bus_times(tmp_path)
    assert set(found) == set(SIDES)
    for answers in found.values():
        assert 50 <= len(answers) <= 60
        assert {carries for carries, _ in answers} == {False, True}
        assert all(ns > 0 for _, ns in answers)


@pytest.mark.slow
@pytest.mark.parametrize("side", SIDES)
def test_an_answer_takes_the_same_bytecodes_in_both_states(side: str, tmp_path: Path) -> None:
    """What the two ends do before a message is on its way does not hang on the state."""
    found = work(side, "sustained", recorded(200, "sustained", tmp_path)[side])
    most = [found[carried].most_common(1)[0] for carried in (False, True)]
    assert most[0][0] == most[1][0]
    for (_, alike), carried in zip(most, (False, True), strict=True):
        assert alike >= 0.9 * found[carried].total() > 20  # a late tick of a busy machine is seen


@pytest.mark.slow
@pytest.mark.parametrize("side", SIDES)
def test_with_keys_too(side: str, tmp_path: Path) -> None:
    """Here an answer's work hangs on the key block, whose place everybody knows."""
    found = work(side, "keys", recorded(200, "keys", tmp_path)[side])
    assert found[False].most_common(1)[0][0] == found[True].most_common(1)[0][0]


@pytest.mark.wrong_on_purpose
@pytest.mark.slow
def test_a_branch_on_the_state_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    right = "if pad == NO_SYMBOL:"
    broken(monkeypatch, core, right, "if pad == NO_SYMBOL or (self.carries and False):")
    found = work("controller", "sustained", recorded(200, "sustained", tmp_path)["controller"])
    assert found[False].most_common(1)[0][1] < 0.9 * found[False].total()


def test_a_life_that_went_otherwise_is_refused(tmp_path: Path) -> None:
    life = recorded(50, "sustained", tmp_path)["controller"]
    life.drawn[:] = [bytes(255 - value for value in draw) for draw in life.drawn]
    with pytest.raises(RuntimeError, match="did not say the same"):
        response_times("controller", "sustained", life)


def test_what_is_told() -> None:
    text = render(measure(700))
    assert text.count("control") == 3
    assert "plant: median" in text
