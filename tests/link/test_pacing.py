"""The plant's clock: deadlines, repeats, swallowed ticks."""

from math import inf

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.link.pacing import LOCKSTEP_REPEAT_S, Pacing, next_turn, phase_of


def running(now_s: float = 0.0, step_s: float | None = 1.0) -> Pacing:
    """A plant that runs, with four measurements a step."""
    return Pacing(step_s, 4, now_s)


def test_a_step_without_an_offer_is_missed_at_its_deadline_and_not_before() -> None:
    pacing = running()
    assert pacing.tick(0.999, running=True) == "nothing"
    assert pacing.tick(1.0, running=True) == "missed"
    assert pacing.tick(1.0, running=True) == "nothing"


def test_a_step_whose_offer_was_applied_ends_at_the_tick() -> None:
    pacing = running()
    pacing.applied()
    assert not pacing.measurement_due(0.9)
    assert pacing.tick(0.9, running=True) == "nothing"
    assert pacing.tick(1.0, running=True) == "ended"
    assert not pacing.waiting
    assert pacing.measurement_due(1.0)


def test_ticks_that_a_stall_swallowed_are_not_made_up_for() -> None:
    """A process that was stopped for 7.3 steps misses one; the next deadline is a whole step on."""
    pacing = running()
    assert pacing.tick(7.3, running=True) == "missed"
    assert pacing.tick(7.3, running=True) == "nothing"
    assert pacing.due_at(running=True, measuring=False) == pytest.approx(8.3)
    assert pacing.tick(8.2, running=True) == "nothing"
    assert pacing.tick(8.3, running=True) == "missed"


def test_a_late_tick_does_not_move_the_deadlines_after_it() -> None:
    pacing = running()
    assert pacing.tick(1.9, running=True) == "missed"
    assert pacing.tick(2.0, running=True) == "missed"
    assert pacing.due_at(running=True, measuring=False) == pytest.approx(3.0)


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


def test_after_a_tick_the_measurement_is_due_at_once() -> None:
    pacing = running()
    assert pacing.measurement_due(0.9)
    assert not pacing.measurement_due(1.0)
    assert pacing.tick(1.0, running=True) == "missed"
    assert pacing.measurement_due(1.0)


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


def test_who_was_due_together_after_a_stall_is_spread_again_at_the_next_turn() -> None:
    phases = [phase_of(f"loop-{i:04}") for i in range(200)]
    stalled_until = 7.3
    turns = sorted(next_turn(stalled_until, 1.0, phase) for phase in phases)
    assert stalled_until < turns[0]
    assert turns[-1] <= stalled_until + 1.0
    in_a_tenth = [
        sum(0.1 * i <= t - stalled_until < 0.1 * (i + 1) for t in turns) for i in range(10)
    ]
    assert max(in_a_tenth) < 40
    assert next_turn(turns[3], 1.0, phases[0]) > turns[3]


def test_a_turn_that_is_now_is_not_its_own_next() -> None:
    assert next_turn(2.25, 1.0, 0.25) == 3.25
    assert next_turn(2.0, 0.05, 0.0) > 2.0


def test_what_a_stall_did_is_measured() -> None:
    """Seconds by which the last tick was late, and how many whole steps went by in all."""
    pacing = running()
    assert (pacing.late_s, pacing.overruns) == (0.0, 0)
    told = []
    for now in (1.0, 2.5, 4.0, 7.25, 8.25):
        pacing.tick(now, running=True)
        told.append((pacing.late_s, pacing.overruns))
    assert told == [(0.0, 0), (0.5, 0), (1.0, 1), (2.25, 3), (0.0, 3)]


def test_a_tick_noticed_a_whole_step_late_has_swallowed_one() -> None:
    pacing = running()
    pacing.tick(2.0, running=True)
    assert pacing.due_at(running=True, measuring=False) == 3.0


def test_the_time_within_a_step_counts_from_its_tick() -> None:
    pacing = running(5.0, 2.0)
    assert pacing.timed
    assert pacing.step_s == 2.0
    assert pacing.since_tick_s(5.5) == 0.5
    pacing.tick(7.5, running=True)
    assert pacing.since_tick_s(8.0) == 1.0
    lockstep = running(5.0, None)
    assert not lockstep.timed
    assert lockstep.step_s is None
    assert lockstep.since_tick_s(8.0) == 0.0


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


def test_in_lock_step_an_offer_asks_for_the_next_measurement_whatever_the_clock_says() -> None:
    pacing = running(0.0, None)
    assert pacing.measurement_due(0.0)
    pacing.applied()
    assert pacing.measurement_due(0.0)


def test_in_lock_step_a_late_answer_does_not_stop_the_repeats() -> None:
    pacing = running(0.0, None)
    pacing.answered_late()
    assert pacing.measurement_due(0.0)
    assert pacing.measurement_due(LOCKSTEP_REPEAT_S)


@given(st.floats(0, 1e6), st.floats(0.01, 10), st.floats(0, 1, exclude_max=True))
def test_a_turn_comes_within_a_step(now: float, step_s: float, phase: float) -> None:
    turn = next_turn(now, step_s, phase)
    assert now < turn <= now + step_s * (1 + 1e-9) + 1e-9
    off = (turn - phase * step_s) / step_s
    assert abs(off - round(off)) * step_s < 1e-8


def test_phases_stay_what_they_were() -> None:
    """A fleet's plants tick together with those that another process runs."""
    assert phase_of("loop-0001") == 0x40C02589 / 2**32


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


def test_nothing_is_measured_between_an_offer_and_its_tick() -> None:
    pacing = running()
    pacing.applied()
    assert pacing.due_at(running=True, measuring=True) == 1.0
    assert pacing.tick(1.0, running=True) == "ended"
    assert pacing.due_at(running=True, measuring=True) == 1.0
    assert pacing.measurement_due(1.0)
    assert pacing.due_at(running=True, measuring=True) == 1.25


def test_a_fleets_first_step_is_longer_by_up_to_one() -> None:
    pacing = Pacing(1.0, 4, 0.0, 0.25)
    pacing.tick(3.0, running=False)
    assert pacing.deadline == 4.25
    assert pacing.tick(4.2, running=True) == "nothing"
    assert pacing.tick(4.25, running=True) == "missed"
    assert pacing.deadline == 5.25
    assert pacing.tick(6.25, running=True) == "missed"
    assert pacing.deadline == 8.25, "a step was swallowed"


def test_a_turn_follows_now_even_where_it_falls_on_it() -> None:
    assert next_turn(1.0, 0.5, 0.0) == 1.5
    assert next_turn(1.25, 0.5, 0.0) == 1.5
    assert next_turn(1.25, 0.5, 0.5) == 1.75
    assert next_turn(0.0, 0.5, 0.5) == 0.25
    assert phase_of("") == 0.0
