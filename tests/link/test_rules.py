"""What both ends share: each rule by itself, and a transition with all its fields."""

from dataclasses import replace

import pytest

from protocol.agreement import AgreementResult, Gauge
from protocol.box_observer import Box, Estimate
from protocol.link.fallback import Fallback
from protocol.link.outputs import MOST_MISSED, OutputRule
from protocol.link.session import rules_of
from protocol.messages import Offer
from protocol.schemes.sealed import Sealed
from protocol.schemes.switched import Switched
from runtime.scenario_file import scenario_of
from tests.support.line import line_rules

RULES = line_rules(alpha=4.0, largest_input=5.0)
S = "1" * 16
CANDIDATES = ((1.5,), (-1.5,))
OFFER = Offer(session=S, k=7, candidates=CANDIDATES, cipher=1)


# --- the test of a transition ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("gauges", "inside", "expected", "fails"),
    [
        ((0.75, 2.0), 1, -1, False),
        ((0.75, 2.0), 1, 0, False),
        ((0.75, 2.0), 1, 1, True),
        ((1.0, 2.0), 1, 0, False),
        ((1.5, 2.0), 0, -1, True),
        ((1.5, 2.0), 0, 0, True),
    ],
)
def test_a_transition_fails_that_nothing_explains_or_another_candidate_than_the_keys(
    gauges: tuple[float, ...], inside: int, expected: int, fails: bool
) -> None:
    verdict = AgreementResult(gauges, 0 if inside else -1, inside)
    assert RULES.fails(verdict, expected) is fails


def test_what_is_expected_is_the_offers_prediction_or_the_models() -> None:
    offer = OFFER.model_copy(update={"predictions": ((8.0,), (9.0,))})
    for candidate in (0, 1):
        assert RULES.prediction((2.0,), offer, candidate) == (2.0 + CANDIDATES[candidate][0],)
        predicted = replace(RULES, predicted=True)
        assert predicted.prediction((2.0,), offer, candidate) == offer.predictions[candidate]
    assert RULES.box(None, 0, (2.0,)) is None


@pytest.mark.parametrize(
    ("keyed", "said", "malformed"),
    [
        (False, (None, None), False),
        (False, (None, 0), True),
        (False, (-1, 0), True),
        (True, (-1, 0), False),
        (True, (3, None), True),
        (True, (None,), True),
        (True, (False,), False),
    ],
)
def test_digits_are_named_where_they_serve_and_nowhere_else(
    keyed: bool, said: tuple[object, ...], malformed: bool
) -> None:
    for rules in (
        replace(RULES, keyed=keyed),
        replace(RULES, scheme=Sealed(2) if keyed else Switched(2)),
    ):
        told = rules.malformed_digits("offer.stream_block", *said)
        assert bool(told) == malformed
        assert told.split(":")[0] == ("offer.stream_block" if malformed else "")


def test_an_offer_takes_a_digit_for_the_coin_and_one_for_a_sealed_symbol() -> None:
    sealed = replace(RULES, scheme=Sealed(2))
    rules = (RULES, replace(RULES, keyed=True), sealed, replace(sealed, keyed=True))
    assert [one.digits for one in rules] == [0, 1, 1, 2]


@pytest.mark.parametrize("name", ["sustained", "watched", "encoder", "pendulum", "motor"])
def test_the_rules_of_a_scenario_are_what_it_says(name: str) -> None:
    s = scenario_of(name)
    rules = rules_of.__wrapped__(s)
    assert (rules.states, rules.inputs, rules.size) == (s.readings, s.m, s.secrecy.candidates)
    assert rules.fingerprint == s.fingerprint()
    assert rules.scheme.name == s.secrecy.scheme
    assert rules.schedule == (None if s.keys is None else s.keys.schedule())
    assert rules.predicted == (s.defender.model is not None)
    assert (rules.keyed, rules.halts) == (s.defence.keyed, s.defence.on_alarm == "safe")
    assert (rules.watch, rules.alarm_rule) == (s.watch, s.alarm_rule)
    assert (rules.agreement.A, rules.agreement.B) == (s.A, s.B)
    assert rules.agreement.alpha == s.secrecy.alpha
    H, h = s.test_set.rows()
    assert rules.agreement.gauge == Gauge.from_rows(H, h)
    assert (rules.agreement.reach is None) == (s.secrecy.disturbance is None)
    assert (rules.agreement.apart is None) == (s.defender.noise is None)
    assert rules.inputs_gauge == Gauge.from_rows(*s.control.inputs.rows())
    assert (rules.outputs is None) == (s.observer is None)
    if rules.outputs is not None:
        assert rules.outputs.alpha == s.secrecy.alpha
        assert rules.outputs.fallback == Fallback.of(s)
        assert rules.outputs.apart == Gauge.from_rows(*s.defender.disturbance.rows())


# --- readings of some outputs ---------------------------------------------------------------------


@pytest.fixture(scope="module")
def rule() -> OutputRule:
    rule = rules_of(scenario_of("encoder")).outputs
    assert rule is not None
    return rule


BOX = Box((0.09995, -0.001), (0.10005, 0.001))
FAR = ((-0.2,), (0.2,))


def estimate(rule: OutputRule) -> Estimate:
    reading = rule.observer.read(rule.predictions(BOX, FAR)[0])
    found = rule.judge(BOX, FAR, reading).estimate
    assert found is not None
    return found


def test_after_many_missed_steps_the_box_begins_anew(rule: OutputRule) -> None:
    at = estimate(rule)
    origin = rule.fallback.input((0.0,) * len(rule.observer.A), (0.125,))
    reading = rule.observer.read(BOX.centre)
    begins = rule.observer.begin(reading)
    assert rule.box(None, 0, reading) == begins
    assert rule.box(at, MOST_MISSED + 1, reading) == begins
    assert rule.box(at, MOST_MISSED, reading) != begins
    assert rule.instead(None, 0, (0.125,)) == origin
    assert rule.instead(at, MOST_MISSED, (0.125,)) == origin
    assert rule.instead(at, MOST_MISSED - 1, (0.125,)) != origin


# --- a transition ---------------------------------------------------------------------------------


# --- what is saved -------------------------------------------------------------------------------
