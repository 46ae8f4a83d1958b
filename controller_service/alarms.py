"""When a transition makes an alarm at the controller."""

from typing import NamedTuple

from protocol.agreement import NO_SYMBOL, fails
from protocol.link.events import Alarm, Reason
from protocol.link.records import AlarmRecord
from protocol.link.session import CountedTransition, Rules
from protocol.messages import Measurement


class Judged(NamedTuple):
    """What the defence says of a transition.

    ``record`` follows from the one before. ``expected`` is the candidate that a digit of the key
    stream chose, -1 where the transition is unwatched. ``reason`` is why it makes an alarm; empty:
    it makes none.
    """

    record: AlarmRecord
    expected: int = NO_SYMBOL
    reason: Reason = ""


def tested(rules: Rules, record: AlarmRecord, t: CountedTransition) -> Judged:
    """Test a transition."""
    expected = t.served[0] if t.served and rules.keyed else NO_SYMBOL
    failure = _failure(rules, t, expected)
    alarm, failed = rules.alarm_rule.test(record.failed, failed=failure != "")
    unwatched, too_many = record.unwatched, False
    if rules.keyed:
        unwatched, too_many = rules.watch.after(unwatched, watched=expected != NO_SYMBOL)
    reason: Reason = failure if alarm else "unwatched" if too_many else ""
    halted = record.halted or (reason != "" and rules.halts)
    return Judged(AlarmRecord(failed, unwatched, halted), expected, reason)


def first(rules: Rules, record: AlarmRecord) -> Judged:
    """A session's first measurement: no transition, and an alarm if too many had no digit.

    Whoever ends each session at its first step would otherwise have all of them unwatched, and none
    counted.
    """
    if not (rules.keyed and record.unwatched > rules.watch.burst):
        return Judged(record)
    alarmed = record._replace(unwatched=0.0, halted=record.halted or rules.halts)
    return Judged(alarmed, reason="unwatched")


def session_ended(rules: Rules, record: AlarmRecord) -> AlarmRecord:
    """A session is over: of its last step nobody has heard."""
    if not rules.keyed:
        return record
    return record._replace(unwatched=rules.watch.unheard(record.unwatched))


def _failure(rules: Rules, t: CountedTransition, expected: int) -> Reason:
    """What speaks against a transition; nothing where it passes its test.

    A plant that has the offer's digits uses them. It has them: once it has announced their block it
    takes no step before it has confirmed it.
    """
    if t.verdict.unexplained or (expected != NO_SYMBOL and fails(t.verdict.gauges, expected)):
        return "unexplained" if expected == NO_SYMBOL else "another candidate"
    if rules.keyed and expected == NO_SYMBOL and t.digits is not None:
        return "digits refused"
    return ""


def alarm_of(
    rules: Rules,
    measurement: Measurement,
    transition: CountedTransition | None,
    reason: Reason,
) -> Alarm:
    """What was read and what was expected where a measurement makes an alarm."""
    if transition is None:
        k = measurement.k - 1
        return Alarm(measurement.session, -1, k, measurement.x, reason, -1, (), 0.0)
    gauges, candidate = transition.verdict.gauges, transition.expected
    if candidate == NO_SYMBOL:
        candidate = gauges.index(min(gauges))
    return Alarm(
        transition.session,
        transition.j,
        transition.k,
        transition.x_next,
        reason,
        candidate,
        rules.prediction(transition, candidate),
        gauges[candidate],
    )
