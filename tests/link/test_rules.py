"""What both ends share: each rule by itself, and a transition with all its fields."""

from dataclasses import replace

import pytest

from protocol.box_observer import Box, Estimate
from protocol.link.outputs import MOST_MISSED, OutputRule
from protocol.link.records import LinkRecord
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


def test_what_is_expected_is_the_offers_prediction_or_the_models() -> None:
    offer = OFFER.model_copy(update={"predictions": ((8.0,), (9.0,))})
    t = RULES.count(LinkRecord(7, (2.0,), state=RULES.scheme.initial), offer, (3.5,), ())
    for candidate in (0, 1):
        assert RULES.prediction(t, candidate) == (2.0 + CANDIDATES[candidate][0],)
        predicted = replace(RULES, predicted=True)
        assert predicted.prediction(t, candidate) == offer.predictions[candidate]
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
