"""The test of a transition where one output alone is read: gauges, verdict, the box after it."""

import pytest

from protocol.agreement import NO_SYMBOL
from protocol.box_observer import Box, Estimate
from protocol.link.effects import Tell
from protocol.link.events import Event, Missed
from protocol.link.outputs import OutputRule
from protocol.link.session import rules_of
from protocol.vectors import Vector
from runtime.scenario_file import scenario_of
from tests.support.recorded_pair import law_of
from wyner.simulate.faults import Faults
from wyner.simulate.network import Simulation

BOX = Box((0.09995, -0.001), (0.10005, 0.001))
"""Where the state of the shipped motor lies: an angle, as it is read, and a speed."""

FAR, NEAR = ((-0.2,), (0.2,)), ((-0.001,), (0.001,))
"""Candidates whose readings are told apart, and candidates whose are not."""

NOWHERE = 9.0


@pytest.fixture(scope="module")
def rule() -> OutputRule:
    rule = rules_of(scenario_of("encoder")).outputs
    assert rule is not None
    return rule


def expected(rule: OutputRule, candidates: tuple[Vector, ...], chosen: int) -> Vector:
    """The reading in the middle of a candidate's."""
    return rule.observer.read(rule.predictions(BOX, candidates)[chosen])


@pytest.mark.parametrize("chosen", [0, 1])
def test_the_one_candidate_that_explains_a_reading_is_the_symbol(
    rule: OutputRule, chosen: int
) -> None:
    verdict = rule.judge(BOX, FAR, expected(rule, FAR, chosen))
    assert verdict.symbol == chosen
    assert verdict.inside == sum(gauge <= 1 for gauge in verdict.gauges) == 1
    assert not verdict.unexplained
    assert verdict.gauges.index(min(verdict.gauges)) == chosen


def test_where_two_explain_it_nothing_is_agreed(rule: OutputRule) -> None:
    verdict = rule.judge(BOX, NEAR, expected(rule, NEAR, 0))
    assert (verdict.symbol, verdict.inside) == (NO_SYMBOL, 2)
    assert max(verdict.gauges) <= 1
    assert not verdict.unexplained


def test_a_reading_that_no_candidate_explains_is_told_and_the_box_begins_anew(
    rule: OutputRule,
) -> None:
    verdict = rule.judge(BOX, FAR, (NOWHERE,))
    assert (verdict.symbol, verdict.inside, verdict.unexplained) == (NO_SYMBOL, 0, True)
    assert min(verdict.gauges) > 1
    assert verdict.estimate is not None
    assert verdict.estimate.inputs == FAR, "any of them may be in force"


def test_a_transition_leaves_a_box_from_which_the_next_is_judged(rule: OutputRule) -> None:
    reading = expected(rule, FAR, 1)
    verdict = rule.judge(BOX, FAR, reading)
    assert verdict.box == BOX
    assert verdict.estimate is not None
    assert verdict.estimate.inputs == (FAR[1],)
    after = rule.box(verdict.estimate, 0, reading)
    assert after == verdict.estimate.box
    centre = rule.predictions(BOX, FAR)[1]
    assert all(low <= v <= high for low, v, high in zip(after.low, centre, after.high, strict=True))
    later = rule.box(verdict.estimate, 1, reading)
    assert later != after, "over a missed step it moves on"
    assert rule.box(None, 0, reading) == rule.observer.begin(reading)


# --- both ends with it ----------------------------------------------------------------------------


def test_both_ends_move_one_box_through_steps_that_are_made_and_missed() -> None:
    """And a plant whose own state is known keeps it, which no reading tells."""
    scenario, law = law_of("encoder")
    world = Simulation(scenario, law, seed=3, faults=Faults(loss=0.3), step_s=0.02)
    history = world.run(steps=300)
    assert history.missed > 20
    rule = rules_of(scenario).outputs
    assert rule is not None
    box: Estimate | None = None
    k = -1
    for at, t in history.plant.items():
        expected = rule.box(box, t.k - k - 1, t.x)
        assert t.verdict.box == expected
        assert t.verdict == rule.judge(expected, t.candidates, t.x_next)
        assert at not in history.controller or history.controller[at].verdict == t.verdict
        box, k = t.verdict.estimate, t.k
        assert t.truth is not None
        assert box is not None
        low, high = box.box
        assert all(a <= v <= b for a, v, b in zip(low, t.truth.x_next, high, strict=True))
    record = world.plant.state.record
    assert record.link.estimate == box, "it stands until the next transition"
    assert len(record.applied.true_x) == scenario.n


def test_a_model_misses_a_step_under_the_input_that_both_ends_reckon_with() -> None:
    """Or, where it holds, under the input in force."""
    scenario, law = law_of("encoder")
    for kind in ("zero", "hold"):
        link = scenario.link.model_copy(update={"fallback": kind})
        own = scenario.model_copy(update={"link": link})
        rule = rules_of(own).outputs
        assert rule is not None
        world = Simulation(own, law, seed=3, step_s=0.02)
        world.run(steps=20)
        record = world.plant.state.record
        missed = [e for e in effects_of(world) if isinstance(e, Missed)]
        u = record.applied.u
        for number, told in enumerate(missed):
            assert told.u == rule.instead(record.link.estimate, number, u)
            u = told.u
        assert len(missed) > 2


def effects_of(world: Simulation) -> list[Event]:
    """What the plant traces once its controller is silent."""
    told: list[Event] = []
    now = world.now_s
    while len(told) < 4:
        now = max(now, world.plant.wake_at())
        told += [e.event for e in world.plant.wake(now) if isinstance(e, Tell)]
    return told
