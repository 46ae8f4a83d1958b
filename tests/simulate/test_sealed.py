"""The scheme `sealed` and the keyed coin between the real ends, in virtual time."""

from functools import partial

import pytest

from protocol.link.session import rules_of
from protocol.secret.stream import NOWHERE
from tests.support.recorded_pair import law_of
from tests.support.watched import Watched
from wyner.simulate.faults import Faults

TEXT = b"Meet me at nine"


def loop_of(name: str, seed: int, faults: Faults | None = None) -> Watched:
    """Both ends of a shipped scenario, which have a message to deliver."""
    return Watched(*law_of(name), seed=seed, payloads=(TEXT,), faults=faults)


def arrived(loop: Watched) -> bool:
    """Whether the plant has the message."""
    return bool(loop.history.inbox)


@pytest.mark.parametrize("name", ["sealed", "watched"])
def test_the_first_digit_serves_when_the_schedule_says_and_then_each_step_has_one(
    name: str,
) -> None:
    loop = loop_of(name, seed=1)
    schedule = rules_of(loop.scenario).schedule
    assert schedule is not None
    steps = 200
    history = loop.run(steps=steps)
    served = [t.k for t in history.plant.values() if t.served]
    assert served == list(range(schedule.first_use, steps))
    assert history.inbox == [TEXT]


def test_a_sealed_message_comes_through_a_network_that_loses_and_ends_that_die() -> None:
    faults = Faults(loss=0.1, repeat=0.1, delay_s=0.02, crash=0.01, until_s=120.0)
    for seed in range(3):
        loop = loop_of("sealed", seed, faults)
        history = loop.run(until=partial(arrived, loop), steps=3000)
        assert history.inbox == [TEXT], seed
        assert history.crashes > 0
        carried = [t for t in history.plant.values() if t.served]
        assert len(carried) >= len(TEXT) * 4
        for t in history.plant.values():
            assert bool(t.served) == (t.message_symbol >= 0)
            assert not t.served or t.digits not in (None, NOWHERE)


def test_a_seed_gives_the_same_keys_and_so_the_same_run() -> None:
    """Nonces came from the operating system, so that no seeded run with keys was ever repeated."""
    faults = Faults(loss=0.05, repeat=0.1, delay_s=0.02, crash=0.01, until_s=30.0)
    first, second = (loop_of("sealed", 4, faults) for _ in range(2))
    for loop in (first, second):
        loop.run(steps=150)
    assert any(t.served for t in first.history.plant.values())
    assert first.sent == second.sent
    assert first.history.plant == second.history.plant
    other = loop_of("sealed", 5, faults)
    other.run(steps=60)
    assert first.sent[: len(other.sent)] != other.sent
