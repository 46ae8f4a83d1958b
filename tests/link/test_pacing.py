"""The plant's clock: deadlines, repeats, swallowed ticks."""

from math import inf

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plant_service.watchdog import FAREWELL_S, Farewell
from protocol.link.pacing import LOCKSTEP_REPEAT_S, Pacing, next_turn


def running(now_s: float = 0.0, step_s: float | None = 1.0) -> Pacing:
    """A plant that runs, with four measurements a step."""
    return Pacing(step_s, 4, now_s)


def test_a_measurement_is_repeated_so_often_a_step() -> None:
    pacing = running()
    due = [0.05 * i for i in range(20) if pacing.measurement_due(0.05 * i)]
    assert due == pytest.approx([0.0, 0.25, 0.5, 0.75])
    assert pacing.due_at(running=True, measuring=True) == pytest.approx(1.0)


@pytest.mark.parametrize("step_s", [None, 1.0])
def test_without_a_controller_only_ticks_are_due(step_s: float | None) -> None:
    pacing = running(0.0, step_s)
    assert pacing.due_at(running=False, measuring=False) == inf
    assert pacing.due_at(running=True, measuring=False) == (inf if step_s is None else 1.0)


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


def test_a_farewell_also_waits_for_the_network_s_round_trip() -> None:
    farewell = Farewell(round_trip_s=3.0)
    assert not farewell.over(10.0)
    assert not farewell.over(10.0 + FAREWELL_S + 2.9)
    assert farewell.over(10.0 + FAREWELL_S + 3.0)
