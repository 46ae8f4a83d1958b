"""How many steps may go unwatched before it is an alarm."""

import pytest

from protocol.defence.watch import NEVER, UNWATCHED, Watch


def alarms(rule: Watch, steps: list[bool], total: float = 0.0) -> list[int]:
    """Numbers of the steps that make an alarm; each says whether it was watched."""
    made = []
    for number, watched in enumerate(steps):
        total, alarm = rule.after(total, watched=watched)
        if alarm:
            made.append(number)
    return made


def test_before_the_first_keys_nothing_is_promised() -> None:
    rule = Watch(0.5, 2)
    assert alarms(rule, [False] * 100, NEVER) == []
    assert rule.after(NEVER, watched=True) == (0.0, False), "the promise begins"
    assert alarms(rule, [True] + [False] * 5, NEVER) == [5]
    assert alarms(UNWATCHED, [False] * 100, NEVER) == []


def test_a_burst_may_go_unwatched_and_one_step_more_is_an_alarm_that_begins_again() -> None:
    assert alarms(Watch(0.0, 3), [False] * 8) == [3, 7]


@pytest.mark.parametrize(("every", "made"), [(4, False), (3, True)])
def test_the_stated_share_may_go_unwatched_for_ever_and_no_more(every: int, made: bool) -> None:
    steps = [k % every != 0 for k in range(1000)]
    assert bool(alarms(Watch(0.25, 2), steps)) == made


def test_watched_steps_are_not_saved_up() -> None:
    assert alarms(Watch(0.25, 2), [True] * 1000 + [False] * 3) == [1002]
