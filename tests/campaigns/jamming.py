"""A relay between the real ends, in virtual time: ``python -m tests.campaigns.jamming``.

It stands on the field bus of `watched`, holds no key, and does to the messages what it likes: it
drops every copy 0, flips each field that no rule protects, strips, replays, and ends sessions. The
sensor is honest, so no test of a reading fails by itself: what alarms is that steps go unwatched.
Judged by what really happened: a step is watched where the plant's coin was the digit that the
controller expected. In any steps in a row without an alarm at most s n + h may be unwatched, from
the first watched one on.
"""

import argparse
import random
import sys
from collections import Counter
from collections.abc import Callable
from typing import Final, NamedTuple
from unittest.mock import patch

from controller_service.laws.registry import cached_design, make_law
from protocol.agreement import NO_SYMBOL
from protocol.link.events import Alarm, Event
from protocol.link.session import CountedTransition, rules_of
from protocol.messages import Measurement, Message, Offer
from protocol.secret import key_digits, stream
from runtime.scenario_file import scenario_of
from wyner.simulate.faults import Faults
from wyner.simulate.network import Side, Simulation

Step = Measurement | Offer
Passed = list[tuple[float, Step]]
"""What reaches the other end in a message's place: seconds late, and what."""

REPLAYED: Final = 64
UNDER_WAY: Final = 2
"""Steps that the plant has made, and of which the controller cannot have heard."""

DIGITS: Final = 8
"""Of a key, where she attacks, so that the stream runs dry within a run."""


class Eve:
    """What a strategy may know: all that has passed, and a generator."""

    def __init__(self, seed: int) -> None:
        self.draw = random.Random(f"eve {seed}")
        self.heard: dict[type[Step], list[Step]] = {Measurement: [], Offer: []}

    def before(self, message: Step) -> Step | None:
        """Some earlier message of the same kind."""
        past = self.heard[type(message)][:-1]
        return self.draw.choice(past) if past else None


Strategy = Callable[[Eve, Step], Passed]


def altered(message: Step, **fields: object) -> Passed:
    """The message with other values."""
    return [(0.0, message.model_copy(update=fields))]


def drop_each_copy_0(eve: Eve, m: Step) -> Passed:
    return [] if m.copy_number == 0 else [(0.0, m)]


def drop_half(eve: Eve, m: Step) -> Passed:
    return [] if eve.draw.random() < 0.5 else [(0.0, m)]


def flip_copy(eve: Eve, m: Step) -> Passed:
    return altered(m, copy_number=1 - m.copy_number)


def flip_taken(eve: Eve, m: Step) -> Passed:
    if isinstance(m, Offer):
        return altered(m, heard=1 - m.heard)
    return altered(m, applied_copy=1 - m.applied_copy)


def flip_nonce(eve: Eve, m: Step) -> Passed:
    other = eve.before(m)
    return [(0.0, m)] if other is None else altered(m, nonce=other.nonce)


def flip_tag(eve: Eve, m: Step) -> Passed:
    return altered(m, tag=m.tag[::-1])


def flip_block(eve: Eve, m: Step) -> Passed:
    return altered(m, block=m.block + 1)


def strip_block(eve: Eve, m: Step) -> Passed:
    return altered(m, block=-1, tag="0" * 32)


def deny_digits(eve: Eve, m: Step) -> Passed:
    return altered(m, keyed=False) if isinstance(m, Measurement) else [(0.0, m)]


def claim_digits(eve: Eve, m: Step) -> Passed:
    return altered(m, keyed=True) if isinstance(m, Measurement) else [(0.0, m)]


def strip_digits(eve: Eve, m: Step) -> Passed:
    none = {"stream_block": -1, "stream_at": 0}
    return altered(m, **none) if isinstance(m, Offer) else [(0.0, m)]


def strip_and_claim_digits(eve: Eve, m: Step) -> Passed:
    return strip_digits(eve, m) if isinstance(m, Offer) else claim_digits(eve, m)


def strip_fields(eve: Eve, m: Step) -> Passed:
    none = {"stream_block": None, "stream_at": None} if isinstance(m, Offer) else {"keyed": None}
    return altered(m, **none)


def shift_digits(eve: Eve, m: Step) -> Passed:
    if isinstance(m, Offer) and m.stream_at is not None and m.position.block >= 0:
        return altered(m, stream_at=m.stream_at + 1)
    return [(0.0, m)]


def replay(eve: Eve, m: Step) -> Passed:
    other = eve.before(m)
    return [(0.0, m), *([(0.01, other)] * REPLAYED if other is not None else [])]


def hold_back(eve: Eve, m: Step) -> Passed:
    return [(eve.draw.choice((0.0, 0.06, 0.3)), m)]


def end_sessions(eve: Eve, m: Step) -> Passed:
    """A forged measurement does not follow: the controller ends the session."""
    if isinstance(m, Measurement) and eve.draw.random() < 0.02:
        return altered(m, k=m.k + 1000, applied_k=m.k + 999, x_after=m.x)
    return [(0.0, m)]


def end_each_session_uncounted(eve: Eve, m: Step) -> Passed:
    """Each session has one step, and ends before the controller has heard of it."""
    if isinstance(m, Measurement) and m.applied_k >= 0:
        return altered(m, k=m.k + 1000, applied_k=m.k + 999, x_after=m.x)
    return [(0.0, m)]


def anything(eve: Eve, m: Step) -> Passed:
    return eve.draw.choice(tuple(STRATEGIES.values()))(eve, m)


def now_and_then(eve: Eve, m: Step) -> Passed:
    return anything(eve, m) if eve.draw.random() < 0.05 else [(0.0, m)]


STRATEGIES: Final[dict[str, Strategy]] = {
    strategy.__name__: strategy
    for strategy in (
        drop_each_copy_0,
        drop_half,
        flip_copy,
        flip_taken,
        flip_nonce,
        flip_tag,
        flip_block,
        strip_block,
        deny_digits,
        claim_digits,
        strip_digits,
        strip_and_claim_digits,
        strip_fields,
        shift_digits,
        replay,
        hold_back,
        end_sessions,
        end_each_session_uncounted,
    )
}
MIXED: Final[dict[str, Strategy]] = {"anything": anything, "now_and_then": now_and_then}


class Found(NamedTuple):
    """What came of a run.

    ``excess`` is the largest number of unwatched steps beyond s n, in n steps without an alarm.
    """

    steps: int
    watched: int
    missed: int
    sessions: int
    crashes: int
    alarms: Counter[str]
    excess: float


class Jammed(Simulation):
    """The ends of `watched`, with a relay between them from a step on."""

    def __init__(
        self, seed: int, strategy: Strategy | None, onset: int = 0, faults: Faults | None = None
    ) -> None:
        scenario = scenario_of("watched")
        self.eve = Eve(seed)
        self.strategy, self.onset = strategy, onset
        self.steps: list[tuple[str, int]] = []
        """Transitions of the plant, in order."""
        self.coins: dict[tuple[str, int], int] = {}
        """Those that a digit chose."""
        self.expected: dict[tuple[str, int], int] = {}
        self.alarms: list[tuple[int, str]] = []
        """Steps that the plant had made, and the reason."""
        law = make_law(scenario, cached_design(scenario))
        super().__init__(scenario, law, seed=seed, run=seed, faults=faults)

    def send(self, to: Side, message: Message) -> None:
        """Pass on what she makes of it."""
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
            self.coins[at] = event.coin if event.keyed else NO_SYMBOL

    def found(self) -> Found:
        """What came of it."""
        watched = [
            self.coins[at] != NO_SYMBOL and self.coins[at] == self.expected.get(at)
            for at in self.steps
        ]
        share = rules_of(self.scenario).watch.share
        alarms = {at for at, _ in self.alarms}
        excess = total = 0.0
        first = watched.index(True) if True in watched else len(watched)
        for i in range(first, len(watched)):
            if i in alarms:
                total = 0.0
            total = max(0.0, total + (0.0 if watched[i] else 1.0) - share)
            excess = max(excess, total)
        return Found(
            len(self.steps),
            sum(watched),
            self.history.missed,
            len({session for session, _ in self.steps}),
            self.history.crashes,
            Counter(reason for _, reason in self.alarms),
            excess,
        )


def jammed(seed: int, strategy: Strategy, *, onset: int, steps: int) -> Found:
    """A run under a strategy, up to that many steps of the plant or as many virtual seconds."""
    with patch.object(stream, "digits", _few):
        loop = Jammed(seed, strategy, onset)
        loop.run(steps=steps, seconds=2.0 * steps)
    return loop.found()


def _few(key: bytes, size: int) -> tuple[int, ...]:
    return key_digits.digits(key, size)[:DIGITS]


def honest(seed: int, steps: int) -> Found:
    """A run in which nobody attacks: a network that loses, and ends that die."""
    draw = random.Random(f"honest {seed}")
    faults = Faults(
        loss=draw.choice((0.0, 0.01, 0.03)),
        repeat=draw.choice((0.0, 0.1)),
        delay_s=draw.choice((0.0, 0.02)),
        crash=draw.choice((0.0, 0.001, 0.005)),
    )
    loop = Jammed(seed, None, faults=faults)
    loop.run(steps=steps)
    return loop.found()


def main(argv: list[str] | None = None) -> int:
    """Run after run; 1 where more went unwatched than is stated, or an honest step alarmed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5, help="runs of each strategy")
    parser.add_argument("--steps", type=int, default=1500)
    parser.add_argument("--onset", type=int, default=300)
    args = parser.parse_args(argv)
    watch = rules_of(scenario_of("watched")).watch
    most, wrong = watch.burst + UNDER_WAY, 0
    for name, strategy in (STRATEGIES | MIXED).items():
        for seed in range(args.seeds):
            found = jammed(seed, strategy, onset=args.onset, steps=args.steps)
            broken = found.excess > most
            wrong += broken
            print("BROKEN" if broken else "ok", name, seed, found._asdict(), flush=True)
    print(f"{wrong} broken; at most {most} beyond {watch.share:g} of the steps")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
