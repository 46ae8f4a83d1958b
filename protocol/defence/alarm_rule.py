"""When a test that an honest step may fail becomes an alarm: r failures among the last s tests.

A fitted D_c promises that a session of L steps leaves it with probability at most p. At ten steps a
second, p = 0.0098 and L = 200 leave 42 honest steps a day outside, were each step drawn by itself;
two failures among six tests are then 0.01 false alarms a day.

That each step is drawn by itself is an assumption beside the promise, which is of sessions: where
one disturbance lasts for several steps, all that is known is that p of the sessions may alarm.
"""

import math
from typing import Final, NamedTuple

DAY_S: Final = 86_400.0


class AlarmRule(NamedTuple):
    """An alarm on ``failures`` of the last ``window`` tests."""

    failures: int = 1
    window: int = 1

    def test(self, before: int, *, failed: bool) -> tuple[bool, int]:
        """Whether one more test makes an alarm, and what to remember for the next one.

        Parameters
        ----------
        before : int
            What was remembered: a bit for each of the ``window`` - 1 tests before, the newest
            lowest, set where it failed. 0 at first.
        failed : bool
            A test that did not fail makes no alarm, whatever those before it did.
        """
        tests = before << 1 | failed
        alarm = failed and tests.bit_count() >= self.failures
        return alarm, tests & ((1 << (self.window - 1)) - 1)

    def false_alarms(self, exit_probability: float, steps: float) -> float:
        """Honest steps that fail and make an alarm, in the mean over ``steps`` of them.

        Each fails with ``exit_probability`` by itself, so that this is exact.
        """
        before = _at_least(self.failures - 1, self.window - 1, exit_probability)
        return steps * exit_probability * before


AT_ONCE: Final = AlarmRule()
"""The first test that fails makes an alarm."""


def exit_probability(session: float, steps: int) -> float:
    """What a step leaves D_c with, where a session of ``steps`` does with probability ``session``.

    1 - (1 - session)^(1 / steps): each step by itself.
    """
    return -math.expm1(math.log1p(-session) / steps)


def alarm_rule(
    session: float,
    steps: int,
    period_s: float,
    false_alarms_a_day: float,
    candidates: int,
) -> AlarmRule:
    """The quickest rule that keeps to a rate of false alarms: fewest failures, longest window.

    A fabricator fails a test with probability 1 - 1/M, so the window holds twice the tests in which
    Eve fails r times in the mean: 2 r M / (M - 1), or as many as the rate allows, but r M / (M - 1)
    at the least.

    Parameters
    ----------
    session : float
        The promise: the probability that a session leaves D_c; 0 where none can.
    steps : int
        Steps of such a session.
    period_s : float
    false_alarms_a_day : float
        Above 0.
    candidates : int
        M, 2 at the least.

    Raises
    ------
    ValueError
        In one line, where no rule of up to ``steps`` tests keeps to the rate, or an argument is
        out of its range.
    """
    for name, value, low, high in (
        ("session", session, 0.0, 1.0),
        ("period_s", period_s, 1e-9, math.inf),
        ("false_alarms_a_day", false_alarms_a_day, 1e-300, math.inf),
        ("candidates", candidates, 2, math.inf),
    ):
        if not low <= value < high:
            raise ValueError(f"{name}: got {value:g}, expected at least {low:g}, below {high:g}")
    if steps < 1:
        raise ValueError(f"steps: got {steps}, expected at least 1")
    exits, day = exit_probability(session, steps), DAY_S / period_s
    if AlarmRule().false_alarms(exits, day) <= false_alarms_a_day:
        return AlarmRule()
    share = 1 - 1 / candidates
    failures = 2
    while math.ceil(failures / share) <= steps:
        shortest, longest = math.ceil(failures / share), math.ceil(2 * failures / share)
        for window in range(min(longest, steps), shortest - 1, -1):
            rule = AlarmRule(failures, window)
            if rule.false_alarms(exits, day) <= false_alarms_a_day:
                return rule
        failures += 1
    raise ValueError(
        f"false_alarms_a_day: got {false_alarms_a_day:g}, which no rule of up to {steps} tests "
        f"keeps to where a session leaves D_c with probability {session:g}"
    )


def _at_least(count: int, trials: int, probability: float) -> float:
    """P[at least ``count`` of ``trials``], summed from the rarer end."""
    return math.fsum(
        math.comb(trials, i) * probability**i * (1 - probability) ** (trials - i)
        for i in range(count, trials + 1)
    )
