"""The plant's clock: deadlines, repeats, swallowed ticks."""

from math import inf

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.link.pacing import LOCKSTEP_REPEAT_S, Pacing, next_turn


def running(now_s: float = 0.0, step_s: float | None = 1.0) -> Pacing:
    """A plant that runs, with four measurements a step."""
    return Pacing(step_s, 4, now_s)


def test_ticks_that_a_stall_swallowed_are_not_made_up_for() -> None:
    """A process that was stopped for 7.3 steps misses one; the next deadline is a whole step on."""
    pacing = running()
    assert pacing.tick(7.3, running=True) == "missed"
    assert pacing.tick(7.3, running=True) == "nothing"
    assert pacing.due_at(running=True, measuring=False) == pytest.approx(8.3)
    assert pacing.tick(8.2, running=True) == "nothing"
    assert pacing.tick(8.3, running=True) == "missed"


def test_before_the_plant_runs_the_deadline_moves_along() -> None:
    pacing = running()
    assert pacing.tick(50.0, running=False) == "nothing"
    assert pacing.tick(50.9, running=True) == "nothing"
    assert pacing.tick(51.0, running=True) == "missed"


def test_a_measurement_is_repeated_so_often_a_step() -> None:
    pacing = running()
    due = [0.05 * i for i in range(20) if pacing.measurement_due(0.05 * i)]
    assert due == pytest.approx([0.0, 0.25, 0.5, 0.75])
    assert pacing.due_at(running=True, measuring=True) == pytest.approx(1.0)


def test_in_lock_step_no_tick_ends_a_step_and_an_offer_asks_for_the_next_measurement() -> None:
    pacing = running(5.0, None)
    assert pacing.tick(1e9, running=True) == "nothing"
    assert pacing.measurement_due(5.0)
    assert not pacing.measurement_due(5.0 + 0.9 * LOCKSTEP_REPEAT_S)
    pacing.applied()
    assert not pacing.waiting
    assert pacing.measurement_due(5.0)
    assert pacing.due_at(running=True, measuring=True) == 5.0 + LOCKSTEP_REPEAT_S


@pytest.mark.parametrize("step_s", [None, 1.0])
def test_without_a_controller_only_ticks_are_due(step_s: float | None) -> None:
    pacing = running(0.0, step_s)
    assert pacing.due_at(running=False, measuring=False) == inf
    assert pacing.due_at(running=True, measuring=False) == (inf if step_s is None else 1.0)


def test_after_a_late_answer_a_measurement_goes_out_once_a_step_until_one_comes_in_time() -> None:
    pacing = running()
    pacing.answered_late()
    for step in range(1, 4):
        now = float(step)
        assert pacing.tick(now, running=True) == "missed"
        assert pacing.measurement_due(now)
        assert not pacing.measurement_due(now + 0.9)
        assert pacing.due_at(running=True, measuring=True) == now + 1
    pacing.applied()
    assert pacing.tick(4.0, running=True) == "ended"
    assert [pacing.measurement_due(4.0), pacing.measurement_due(4.25)] == [True, True]


@pytest.mark.parametrize("phase", [0.0, 0.25, 0.95])
def test_in_a_fleet_ticks_keep_their_phase_whatever_happens(phase: float) -> None:
    pacing = Pacing(0.1, 4, 12.345, phase)
    now = 12.345
    for stall in (0.0, 0.03, 7.31, 0.0, 0.1):
        pacing.tick(now, running=False)
        began, due = now, pacing.due_at(running=True, measuring=False)
        assert 0.1 - 1e-9 <= due - began <= 0.2 + 1e-9
        assert (due / 0.1 - phase) % 1 == pytest.approx(0, abs=1e-6) or (
            due / 0.1 - phase
        ) % 1 == pytest.approx(1, abs=1e-6)
        now = due + stall
        assert pacing.tick(now, running=True) == "missed"
        assert pacing.due_at(running=True, measuring=False) > now


def test_what_a_stall_did_is_measured() -> None:
    """Seconds by which the last tick was late, and how many whole steps went by in all."""
    pacing = running()
    assert (pacing.late_s, pacing.overruns) == (0.0, 0)
    told = []
    for now in (1.0, 2.5, 4.0, 7.25, 8.25):
        pacing.tick(now, running=True)
        told.append((pacing.late_s, pacing.overruns))
    assert told == [(0.0, 0), (0.5, 0), (1.0, 1), (2.25, 3), (0.0, 3)]


def test_the_first_measurement_is_due_at_once_and_not_before() -> None:
    pacing = running(5.0)
    assert pacing.due_at(running=True, measuring=True) == 5.0
    assert not pacing.measurement_due(4.9)
    assert pacing.measurement_due(5.0)
    assert pacing.due_at(running=True, measuring=True) == 5.25
    assert not pacing.measurement_due(5.2)
    assert pacing.measurement_due(5.25)
    pacing.applied()
    assert pacing.due_at(running=True, measuring=True) == 6.0
    assert pacing.due_at(running=False, measuring=True) == inf


@given(st.floats(0, 1e6), st.floats(0.01, 10), st.floats(0, 1, exclude_max=True))
def test_a_turn_comes_within_a_step(now: float, step_s: float, phase: float) -> None:
    turn = next_turn(now, step_s, phase)
    assert now < turn <= now + step_s * (1 + 1e-9) + 1e-9
    off = (turn - phase * step_s) / step_s
    assert abs(off - round(off)) * step_s < 1e-8


def test_a_repeat_that_would_come_as_late_as_half_an_interval_before_the_tick_is_not_made() -> None:
    """Intervals of a quarter: at the tick less an eighth one is still sent, and after it none."""
    for now, following in ((0.625, 0.875), (0.6875, 1.0)):
        pacing = running()
        assert pacing.measurement_due(now)
        assert pacing.due_at(running=True, measuring=True) == following


def test_repeats_in_lock_step_come_at_an_interval_of_their_own() -> None:
    pacing = Pacing(None, 4, 2.0)
    for i in range(3):
        now = pacing.due_at(running=True, measuring=True)
        assert now == pytest.approx(2.0 + i * LOCKSTEP_REPEAT_S)
        assert pacing.measurement_due(now)
    assert pacing.deadline == 2.0
