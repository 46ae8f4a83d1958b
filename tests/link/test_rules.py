"""What both ends share: each rule by itself, and a transition with all its fields."""

from dataclasses import replace

import pytest

from protocol.agreement import AgreementResult, Gauge
from protocol.box_observer import Box, Estimate
from protocol.link.fallback import Fallback
from protocol.link.outputs import MOST_MISSED, OUTSIDE, OutputRule
from protocol.link.records import LinkRecord
from protocol.link.session import Counted, CountedTransition, Truth, rules_of
from protocol.messages import Offer
from protocol.schemes.base import Carry
from protocol.schemes.pipelined import Pipelined
from protocol.schemes.sealed import Sealed
from protocol.schemes.switched import Switched
from protocol.secret.nonces import Contribution
from protocol.secret.stream import NOWHERE, Position
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


def test_over_missed_steps_the_box_is_predicted_with_the_fallbacks_input(rule: OutputRule) -> None:
    at = estimate(rule)
    box, inputs = at.box, at.inputs
    for missed in range(3):
        reading = rule.observer.read(box.centre)
        assert rule.box(at, missed, reading) == (
            box if missed == 0 else rule.observer.met(box, reading)
        )
        u = rule.fallback.input(box.centre, (9.0,))
        assert rule.instead(at, missed, (9.0,)) == u
        assert rule.fallback.kind != "hold"
        inputs = (rule.fallback.input(box.centre, inputs[0]),)
        box = rule.observer.moved(box, inputs)


def test_a_plant_that_holds_is_predicted_under_the_inputs_that_may_be_in_force(
    rule: OutputRule,
) -> None:
    held = replace(rule, fallback=replace(rule.fallback, kind="hold"))
    at = Estimate(BOX, FAR)
    moved = rule.observer.moved(rule.observer.moved(BOX, FAR), FAR)
    reading = rule.observer.read(moved.centre)
    assert held.box(at, 2, reading) == rule.observer.met(moved, reading)
    assert held.instead(at, 2, (0.125,)) == (0.125,)


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


def test_gauges_say_how_far_a_reading_lies_over_how_far_it_may(rule: OutputRule) -> None:
    expected = [rule.observer.read(c) for c in rule.predictions(BOX, FAR)]
    reach = rule.observer.reach(BOX)
    for off in (0.0, 0.5, 0.99):
        reading = tuple(v + off * r for v, r in zip(expected[1], reach, strict=True))
        verdict = rule.judge(BOX, FAR, reading)
        assert verdict.gauges[1] == pytest.approx(off, abs=1e-6)
        assert verdict.symbol == 1
        assert verdict.gauges[0] >= OUTSIDE
        assert verdict.gauges[0] == pytest.approx(
            max(abs(v - c) / r for v, c, r in zip(reading, expected[0], reach, strict=True))
        )


def test_candidates_that_lie_too_far_apart_agree_on_nothing(rule: OutputRule) -> None:
    reading = rule.observer.read(rule.predictions(BOX, FAR)[0])
    assert rule.judge(BOX, FAR, reading).symbol == 0
    strict = replace(rule, alpha=1.0)
    verdict = strict.judge(BOX, FAR, reading)
    assert (verdict.symbol, verdict.inside, verdict.unexplained) == (-1, 1, False)
    rules = rules_of(scenario_of("encoder"))
    assert rules.judge((), FAR, (), reading, BOX) == rule.judge(BOX, FAR, reading)
    offer = OFFER.model_copy(update={"candidates": FAR})
    for candidate in (0, 1):
        told = rules.prediction((), offer, candidate, BOX)
        assert told == rule.observer.read(rule.predictions(BOX, FAR)[candidate])
    assert rules.box(None, 0, reading) == rule.box(None, 0, reading)
    assert rules.box(estimate(rule), 1, reading) == rule.box(estimate(rule), 1, reading)


# --- a transition ---------------------------------------------------------------------------------

VERDICT = AgreementResult((0.0, 3.0), 0, 1)
ROW = Contribution(4, 1, b"n" * 32, None)


@pytest.mark.parametrize("carried", [True, False])
@pytest.mark.parametrize("digits", [None, NOWHERE, Position(2, 5)])
def test_a_transition_has_what_its_record_its_offer_and_its_verdict_say(
    carried: bool, digits: Position | None
) -> None:
    state = Switched(2).restore((2, 1) if carried else (1, -1))
    before = LinkRecord(7, (2.0,), state=state, transitions=4, p=9)
    after = LinkRecord(8, (3.5,), state=(2, 0), transitions=5, p=10 if carried else 9)
    offer = OFFER.model_copy(
        update={
            "predictions": ((3.0,), (4.0,)),
            "stream_block": None if digits is None else digits.block,
            "stream_at": None if digits is None else digits.at,
        }
    )
    named = digits if digits != NOWHERE else None
    keyed = named is not None
    truth = Truth((7.0,), (8.0,))
    carry = Carry(0 if not carried else -1, 1 if carried else -1)
    made = CountedTransition.of(
        Switched(2),
        before,
        offer,
        (3.5,),
        Counted(VERDICT, after, carry, (1,) if keyed else ()),
        1 if carried else -1,
        ROW,
        1,
        (1.5,),
        truth,
        0,
    )
    assert made == CountedTransition(
        session=S,
        j=4,
        k=7,
        x=(2.0,),
        candidates=CANDIDATES,
        cipher=1,
        x_next=(3.5,),
        role="message" if carried else "test",
        verdict=VERDICT,
        symbol=carry.agreed,
        key=carry.pad,
        message_symbol=1 if carried else -1,
        p=10 if carried else 9,
        s=2,
        tested=not carried,
        counts=ROW.counts,
        predictions=((3.0,), (4.0,)),
        coin=1,
        u=(1.5,),
        truth=truth,
        digits=named,
        keyed=keyed,
        expected=0,
    )
    assert made.shared == made._replace(coin=-1, u=(), truth=None, expected=-1)
    told = made.as_event()
    assert told["coin"] == 1
    assert told["u"] == (1.5,)
    assert told["expected"] == 0
    assert (told["true_x_next"], told["true_u"]) == ((7.0,), (8.0,))
    assert "attack_failed" not in told
    assert (told.get("digits"), told.get("keyed")) == (named, keyed or None)
    public = made.shared.as_event()
    assert not {"coin", "u", "expected", "true_u", "true_x_next"} & set(public)
    none = CountedTransition.of(
        Pipelined(2), before, offer, (3.5,), Counted(VERDICT, after, carry, ()), 1, None
    )
    assert (none.counts, none.coin, none.u, none.truth, none.expected) == (0, -1, (), None, -1)
    assert none.tested, "each transition is tested there"


# --- what is saved -------------------------------------------------------------------------------
