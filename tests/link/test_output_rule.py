"""The test of a transition where one output alone is read: gauges, verdict, the box after it."""

from dataclasses import replace

import pytest

from protocol.agreement import NO_SYMBOL
from protocol.box_observer import Box, Estimate
from protocol.link.events import Alarm
from protocol.link.outputs import MOST_MISSED, OutputRule
from protocol.link.session import Truth, rules_of
from protocol.messages import Measurement
from protocol.vectors import Vector
from runtime.scenario_file import scenario_of
from tests.support.asked import gathered
from tests.support.controller_in_hand import ControllerInHand
from tests.support.line_ends import line_rules
from tests.support.plant_in_hand import PlantInHand
from tests.support.records import plant_record

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

S, A, P, NEW = "1" * 16, "a" * 16, "c" * 16, "9" * 16
RULES = rules_of(scenario_of("encoder"))


class Pair:
    """Both ends, on a plant that goes where it is told."""

    def __init__(self) -> None:
        self.asked: list[Vector] = []
        self.controller = ControllerInHand(RULES, self.propose, A)
        first = plant_record(session=S, k=0, x=(0.1,), u=(0.0,))
        self.plant = PlantInHand(RULES, P, first)
        self.meet()

    def propose(self, x: Vector) -> tuple[Vector, ...]:
        self.asked.append(x)
        return tuple((0.4 * i / (RULES.size - 1) - 0.2,) for i in range(RULES.size))

    def meet(self) -> None:
        self.plant.heard_controller(self.controller.greeting(), NEW)
        said = self.controller.heard_plant(self.plant.hello()).reply
        assert said is not None
        assert self.plant.heard_controller(said, NEW) == "accepted"

    def step(self, rule: OutputRule, coin: int, off: float = 0.0) -> Estimate | None:
        """A step that is read as its candidate's prediction says, and ``off`` beside that."""
        record = self.plant.record
        box = rule.box(
            record.link.estimate, record.link.k - record.link.applied_k - 1, record.link.x
        )
        offer = self.controller.measured(self.plant.measurement()).offer
        assert offer is not None
        self.controller.finish_step()
        assert self.controller.record.link.estimate == record.link.estimate
        assert self.asked.pop() == box.centre, "the law is asked of the middle of the box"
        (y,) = rule.observer.read(rule.predictions(box, offer.candidates)[coin])
        transition = self.plant.applied(offer, coin, (y + off,))
        expected = rule.judge(box, offer.candidates, (y + off,))
        assert transition.verdict == expected
        assert self.plant.record.link.estimate == expected.estimate
        return expected.estimate


def test_both_ends_move_one_box_through_steps_that_are_made_and_missed(rule: OutputRule) -> None:
    pair = Pair()
    assert pair.step(rule, 0) is not None
    for missed in (0, 1, 3, MOST_MISSED + 1, 0):
        for _ in range(missed):
            pair.plant.missed((0.0,), pair.plant.record.link.x)
        pair.step(rule, 1)
    before = pair.plant.record.link.estimate
    pair.step(rule, 0, off=NOWHERE)
    assert pair.plant.record.link.estimate != before
    pair.step(rule, 1)


def test_a_model_misses_a_step_under_the_input_that_both_ends_reckon_with(
    rule: OutputRule,
) -> None:
    pair = Pair()
    pair.step(rule, 1)
    estimate, u = pair.plant.record.link.estimate, pair.plant.record.applied.u
    for missed in range(3):
        pair.plant.line.x_next = pair.plant.record.link.x
        told = pair.plant.miss()
        assert told.u == rule.instead(estimate, missed, u)
        u = told.u
    assert pair.plant.record.link.estimate == estimate, "it stands until the next transition"


def test_a_model_that_holds_misses_a_step_under_the_input_in_force(rule: OutputRule) -> None:
    held = replace(rule, fallback=replace(rule.fallback, kind="hold"))
    record = plant_record(session=S, k=1, x=(0.1,), u=(0.125,))
    plant = PlantInHand(replace(RULES, outputs=held), P, record)
    plant.line.x_next = (0.1,)
    assert plant.miss().u == (0.125,)


def test_a_record_keeps_the_state_that_no_reading_tells(rule: OutputRule) -> None:
    pair = Pair()
    seen: list[Vector] = []
    pair.plant.line.truth = Truth((0.5, -0.25), (0.0,))
    pair.step(rule, 1)
    seen.append(pair.plant.record.applied.true_x)
    for truth in (Truth((0.75, 0.125), (0.0,)), None):
        pair.plant.line.truth = truth
        pair.plant.missed((0.0,), pair.plant.record.link.x)
        seen.append(pair.plant.record.applied.true_x)
    assert seen == [(0.5, -0.25), (0.75, 0.125), ()]
    read = PlantInHand(line_rules(4.0, 5.0), P, plant_record(S, 1, (0.0,), (0.0,)))
    read.line.truth = Truth((7.0,), (0.0,))
    read.missed((0.0,), (1.0,))
    assert read.record.applied.true_x == (), "where all is read it stands in x"


def test_a_session_begins_without_a_box(rule: OutputRule) -> None:
    pair = Pair()
    pair.step(rule, 1)
    reported = pair.plant.measurement()
    said = reported.model_copy(update={"x_after": ()}).wire()
    gathered(pair.controller.core.receive(Measurement, said, 1.0))
    pair.plant.heard_controller(pair.controller.greeting(), NEW)
    unknown = pair.controller.heard_plant(pair.plant.hello()).reply
    assert unknown is not None
    assert pair.plant.heard_controller(unknown, NEW) == "ended"
    assert (pair.plant.record.link.estimate, pair.controller.record.link.estimate) == (None, None)


def test_an_alarm_says_what_would_have_been_read(rule: OutputRule) -> None:
    pair = Pair()
    record = pair.plant.record
    box = rule.box(None, 0, record.link.x)
    pair.step(rule, 1, off=NOWHERE)
    asked = gathered(
        pair.controller.core.receive(Measurement, pair.plant.measurement().wire(), 1e6)
    )
    (alarm,) = [event for event in asked.events if isinstance(event, Alarm)]
    predictions = rule.predictions(box, pair.propose(record.link.x))
    assert alarm.expected == rule.observer.read(predictions[alarm.candidate])
    assert alarm.reading == pair.plant.record.link.x
