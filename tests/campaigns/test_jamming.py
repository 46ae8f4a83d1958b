"""A relay that jams, between the real ends in virtual time, and a rule that it finds broken.

It stands on the field bus of `watched`, holds no key, and does to the messages what it likes: it
drops every copy 0, flips each field that no rule protects, strips, replays, and ends sessions. The
sensor is honest, so no test of a reading fails by itself: what alarms is that steps go unwatched.
Judged by what really happened: a step is watched where the plant's coin was the digit that the
controller expected. In any steps in a row without an alarm at most s n + h may be unwatched, from
the first watched one on.
"""

import random
from collections import Counter
from collections.abc import Callable
from typing import Any, Final

import pytest

from controller_service import alarms
from protocol.agreement import NO_SYMBOL
from protocol.link.events import Alarm, Event
from protocol.link.session import CountedTransition, rules_of
from protocol.messages import Measurement, Message, Offer
from runtime.scenario_file import scenario_of
from tests.support.broken import broken
from tests.support.recorded_pair import law_of
from tests.support.short_keys import short_keys
from tests.support.size import size
from wyner.simulate.faults import Faults
from wyner.simulate.network import Side, Simulation

Step = Measurement | Offer
Passed = list[tuple[float, Step]]
"""What reaches the other end in a message's place: seconds late, and what."""

Strategy = Callable[["Eve", Step], Passed]

REPLAYED: Final = 64
UNDER_WAY: Final = 2
"""Steps that the plant has made, and of which the controller cannot have heard."""

DIGITS: Final = 8
"""Of a key, where Eve attacks, so that the stream runs dry within a run."""


class Eve:
    """What a strategy may know: all that has passed, and a generator."""

    def __init__(self, seed: int) -> None:
        self.draw = random.Random(f"eve {seed}")
        self.heard: dict[type[Step], list[Step]] = {Measurement: [], Offer: []}

    def before(self, message: Step) -> Step | None:
        """Some earlier message of the same kind."""
        past = self.heard[type(message)][:-1]
        return self.draw.choice(past) if past else None


def altering(
    offer: Callable[[Offer], dict[str, Any]], measurement: Callable[[Measurement], dict[str, Any]]
) -> Strategy:
    """The same message with other values in some fields."""

    def altered(eve: Eve, m: Step) -> Passed:
        fields = offer(m) if isinstance(m, Offer) else measurement(m)
        return [(0.0, m.model_copy(update=fields))]

    return altered


def in_both(fields: Callable[[Any], dict[str, Any]]) -> Strategy:
    return altering(fields, fields)


def as_it_is(_: Step) -> dict[str, Any]:
    return {}


def shifted(m: Offer) -> dict[str, Any]:
    named = m.stream_at is not None and m.position.block >= 0
    return {"stream_at": m.position.at + 1} if named else {}


def forged(m: Step) -> dict[str, Any]:
    """A measurement that does not follow: the controller ends the session."""
    assert isinstance(m, Measurement)
    return {"k": m.k + 1000, "applied_k": m.k + 999, "x_after": m.x}


def drop_each_copy_0(eve: Eve, m: Step) -> Passed:
    return [] if m.copy_number == 0 else [(0.0, m)]


def drop_half(eve: Eve, m: Step) -> Passed:
    return [] if eve.draw.random() < 0.5 else [(0.0, m)]


def flip_nonce(eve: Eve, m: Step) -> Passed:
    other = eve.before(m) or m
    return [(0.0, m.model_copy(update={"nonce": other.nonce}))]


def replay(eve: Eve, m: Step) -> Passed:
    other = eve.before(m)
    return [(0.0, m), *([(0.01, other)] * REPLAYED if other is not None else [])]


def hold_back(eve: Eve, m: Step) -> Passed:
    return [(eve.draw.choice((0.0, 0.06, 0.3)), m)]


def end_sessions(eve: Eve, m: Step) -> Passed:
    ends = isinstance(m, Measurement) and eve.draw.random() < 0.02
    return [(0.0, m.model_copy(update=forged(m) if ends else {}))]


def end_each_session_uncounted(eve: Eve, m: Step) -> Passed:
    """Each session has one step, and ends before the controller has heard of it."""
    ends = isinstance(m, Measurement) and m.applied_k >= 0
    return [(0.0, m.model_copy(update=forged(m) if ends else {}))]


def anything(eve: Eve, m: Step) -> Passed:
    return eve.draw.choice(ALTERATIONS)(eve, m)


def now_and_then(eve: Eve, m: Step) -> Passed:
    return anything(eve, m) if eve.draw.random() < 0.05 else [(0.0, m)]


NO_DIGITS: Final = {"stream_block": -1, "stream_at": 0}
STRATEGIES: Final[dict[str, Strategy]] = {
    "drop each copy 0": drop_each_copy_0,
    "drop half": drop_half,
    "flip the copy": in_both(lambda m: {"copy_number": 1 - m.copy_number}),
    "flip what was taken": altering(
        lambda m: {"heard": 1 - m.heard}, lambda m: {"applied_copy": 1 - m.applied_copy}
    ),
    "flip the nonce": flip_nonce,
    "flip the tag": in_both(lambda m: {"tag": m.tag[::-1]}),
    "flip the block": in_both(lambda m: {"block": m.block + 1}),
    "strip the block": in_both(lambda m: {"block": -1, "tag": "0" * 32}),
    "deny digits": altering(as_it_is, lambda m: {"keyed": False}),
    "claim digits": altering(as_it_is, lambda m: {"keyed": True}),
    "strip digits": altering(lambda m: NO_DIGITS, as_it_is),
    "strip and claim digits": altering(lambda m: NO_DIGITS, lambda m: {"keyed": True}),
    "strip fields": altering(
        lambda m: {"stream_block": None, "stream_at": None}, lambda m: {"keyed": None}
    ),
    "shift digits": altering(shifted, as_it_is),
    "replay": replay,
    "hold back": hold_back,
    "end sessions": end_sessions,
    "end each session uncounted": end_each_session_uncounted,
}
ALTERATIONS: Final = tuple(STRATEGIES.values())
MIXED: Final[dict[str, Strategy]] = {"anything": anything, "now and then": now_and_then}


class Jammed(Simulation):
    """The ends of `watched`, with a relay between them from a step on; or with faults alone."""

    def __init__(
        self, seed: int, strategy: Strategy | None, onset: int = 0, faults: Faults | None = None
    ) -> None:
        scenario, law = law_of("watched")
        self.eve = Eve(seed)
        self.strategy, self.onset = strategy, onset
        self.steps: list[tuple[str, int]] = []
        """Transitions of the plant, in order."""
        self.coins: dict[tuple[str, int], int] = {}
        """Those that a digit chose."""
        self.expected: dict[tuple[str, int], int] = {}
        self.alarms: list[tuple[int, str]] = []
        """Steps that the plant had made, and the reason."""
        super().__init__(scenario, law, seed=seed, run=seed, faults=faults)

    def send(self, to: Side, message: Message) -> None:
        """Pass on what Eve makes of it."""
        if self.strategy is None or not isinstance(message, Measurement | Offer):
            super().send(to, message)
            return
        self.eve.heard[type(message)].append(message)
        del self.eve.heard[type(message)][:-2000]
        passed: Passed = [(0.0, message)]
        if self.k >= self.onset:
            passed = self.strategy(self.eve, message)
        for late, one in passed:
            self.after(late, lambda one=one: self.deliver(to, one))  # type: ignore[misc]

    def traced(self, event: Event) -> None:
        """Note what was watched, and alarms."""
        super().traced(event)
        if isinstance(event, Alarm):
            self.alarms.append((len(self.steps), event.reason))
        if not isinstance(event, CountedTransition):
            return
        at = event.session, event.j
        if event.coin == NO_SYMBOL:
            self.expected[at] = event.expected
        elif at not in self.coins:
            self.steps.append(at)
            self.coins[at] = event.coin if event.served else NO_SYMBOL

    @property
    def watched(self) -> list[bool]:
        """Whether each step was."""
        coins = self.coins
        return [coins[at] != NO_SYMBOL and coins[at] == self.expected.get(at) for at in self.steps]

    @property
    def excess(self) -> float:
        """The largest number of unwatched steps beyond s n, in n steps without an alarm."""
        watched, share = self.watched, rules_of(self.scenario).watch.share
        alarmed = {at for at, _ in self.alarms}
        most = total = 0.0
        first = watched.index(True) if True in watched else len(watched)
        for i in range(first, len(watched)):
            if i in alarmed:
                total = 0.0
            total = max(0.0, total + (0.0 if watched[i] else 1.0) - share)
            most = max(most, total)
        return most


def jammed(strategy: Strategy, seed: int = 1) -> Jammed:
    """A run under a strategy, up to so many steps of the plant or as many virtual seconds."""
    steps = size(700, 2500)
    with short_keys(DIGITS):
        loop = Jammed(seed, strategy, 200)
        loop.run(steps=steps, seconds=2.0 * steps)
    return loop


MOST = rules_of(scenario_of("watched")).watch.burst + UNDER_WAY


@pytest.mark.long
@pytest.mark.parametrize("seed", size(range(1, 2), range(3)))
@pytest.mark.parametrize("name", [*STRATEGIES, *MIXED])
def test_no_relay_makes_the_loop_run_unwatched_without_an_alarm(name: str, seed: int) -> None:
    loop = jammed((STRATEGIES | MIXED)[name], seed)
    assert sum(loop.watched) > 50
    assert loop.excess <= MOST


def test_who_ends_each_session_at_its_first_step_is_alarmed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """None of those steps was ever counted: 500 in a row went unwatched without an alarm."""
    loop = jammed(end_each_session_uncounted)
    assert loop.excess <= MOST
    assert Counter(reason for _, reason in loop.alarms)["unwatched"] >= 2
    broken(monkeypatch, alarms, "rules.watch.unheard(record.unwatched)", "record.unwatched")
    assert jammed(end_each_session_uncounted).excess > MOST


@pytest.mark.long
def test_an_honest_loop_under_losses_and_deaths_makes_no_alarm() -> None:
    crashes = watched = 0
    for seed in range(size(4, 20)):
        draw = random.Random(f"honest {seed}")
        faults = Faults(
            loss=draw.choice((0.0, 0.01, 0.03)),
            repeat=draw.choice((0.0, 0.1)),
            delay_s=draw.choice((0.0, 0.02)),
            crash=draw.choice((0.0, 0.001, 0.005)),
        )
        loop = Jammed(seed, None, faults=faults)
        loop.run(steps=600)
        assert not loop.alarms
        crashes += loop.history.crashes
        watched += sum(loop.watched)
    assert crashes > 0
    assert watched > 1000
