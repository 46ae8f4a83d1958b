"""The timing test sees what it must, and nothing where there is nothing."""

import random
from pathlib import Path
from typing import Any

import pytest

from benchmarks.timing import SIDES, difference, measure, recorded, render, response_times
from benchmarks.work import work
from protocol.link.sender import Sender


def times(seed: int, count: int, longer: float = 0.0) -> list[float]:
    """A service's times: about 80 us, now and then much longer."""
    draw = random.Random(seed)
    return [
        80_000 + draw.gauss(0, 4000) + longer + (1e6 if draw.random() < 0.02 else 0)
        for _ in range(count)
    ]


def test_a_microsecond_is_seen_and_noise_is_not() -> None:
    assert not any(difference(times(s, 2000), times(s + 100, 2000)).seen for s in range(20))
    found = [difference(times(s, 2000), times(s + 100, 2000, 1000.0)) for s in range(20)]
    assert all(one.seen for one in found)
    assert sum(one.ns for one in found) / 20 == pytest.approx(1000, abs=100)


def test_the_standard_error_is_the_differences_own_spread() -> None:
    found = [difference(times(s, 500), times(s + 1000, 500)) for s in range(200)]
    spread = (sum(one.ns**2 for one in found) / 200) ** 0.5
    mean_error = sum(one.error_ns for one in found) / 200
    assert spread == pytest.approx(mean_error, rel=0.15)


def test_too_few_values_are_refused() -> None:
    with pytest.raises(ValueError, match="ten values"):
        difference([1.0] * 9, [1.0] * 20)


@pytest.mark.parametrize("scenario", ["sustained", "keys"])
def test_both_ends_answers_are_timed_in_both_states(scenario: str, tmp_path: Path) -> None:
    lives = recorded(200, scenario, tmp_path)
    for side in SIDES:
        found = response_times(side, scenario, lives[side], added_ns=300_000)
        assert min(found[True]) >= 300_000 > sorted(found[False])[len(found[False]) // 2]
        assert len(found[False]) + len(found[True]) >= 150


@pytest.mark.parametrize("side", SIDES)
def test_an_answer_takes_the_same_bytecodes_in_both_states(side: str, tmp_path: Path) -> None:
    """What the two ends do before a message is on its way does not hang on the state."""
    found = work(side, "sustained", recorded(200, "sustained", tmp_path)[side])
    assert min(map(sum, (found[carried].values() for carried in (False, True)))) > 20
    assert set(found[False]) == set(found[True])
    assert len(found[True]) == 1


@pytest.mark.parametrize("side", SIDES)
def test_with_keys_too(side: str, tmp_path: Path) -> None:
    """Here an answer's work hangs on the key block, whose place everybody knows."""
    found = work(side, "keys", recorded(200, "keys", tmp_path)[side])
    assert found[False].most_common(1)[0][0] == found[True].most_common(1)[0][0]


def test_a_branch_on_the_state_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    decide = Sender._decide

    def longer(self: Sender, state: tuple[int, ...], *of: Any) -> Any:
        if state[0] == 2:
            self.rules.size  # noqa: B018
        return decide(self, state, *of)

    monkeypatch.setattr(Sender, "_decide", longer)
    found = work("controller", "sustained", recorded(200, "sustained", tmp_path)["controller"])
    assert len(found[False]) > 1


def test_a_life_that_went_otherwise_is_refused(tmp_path: Path) -> None:
    life = recorded(50, "sustained", tmp_path)["controller"]
    life.drawn[:] = [bytes(255 - value for value in draw) for draw in life.drawn]
    with pytest.raises(RuntimeError, match="did not say the same"):
        response_times("controller", "sustained", life)


def test_what_is_told() -> None:
    text = render(measure(300))
    assert text.count("control") == 3
    assert "plant: median" in text
