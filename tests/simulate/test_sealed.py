"""The scheme `sealed` and the keyed coin between the real ends, in virtual time."""

from functools import partial

import pytest

from controller_service.laws.registry import cached_design, make_law
from protocol.link.events import Alarm, Event
from protocol.link.session import rules_of
from protocol.messages import Message, Offer
from protocol.secret.stream import NOWHERE
from runtime.scenario_file import scenario_of
from tests.support.once import Digits
from wyner.simulate.faults import Faults
from wyner.simulate.network import Side, Simulation

TEXT = b"Meet me at nine"


class Looked(Simulation):
    """A simulation whose offers and transitions are looked at."""

    def __init__(self, name: str, seed: int, faults: Faults | None = None) -> None:
        scenario = scenario_of(name)
        self.digits = Digits(rules_of(scenario).digits)
        self.sent: list[Message] = []
        self.alarms: list[Alarm] = []
        law = make_law(scenario, cached_design(scenario))
        super().__init__(scenario, law, seed=seed, payloads=(TEXT,), faults=faults)

    def send(self, to: Side, message: Message) -> None:
        """Note it."""
        self.sent.append(message)
        if isinstance(message, Offer):
            self.digits.named(message)
        super().send(to, message)

    def traced(self, event: Event) -> None:
        """Note an alarm."""
        super().traced(event)
        if isinstance(event, Alarm):
            self.alarms.append(event)


def arrived(loop: Looked) -> bool:
    """Whether the plant has the message."""
    return bool(loop.history.inbox)


@pytest.mark.parametrize("name", ["sealed", "watched"])
def test_the_first_digit_serves_when_the_schedule_says_and_then_each_step_has_one(
    name: str,
) -> None:
    loop = Looked(name, seed=1)
    schedule = rules_of(loop.scenario).schedule
    assert schedule is not None
    steps = 200
    history = loop.run(steps=steps)
    served = [t.k for t in history.plant.values() if t.served]
    assert served == list(range(schedule.first_use, steps))
    assert history.inbox == [TEXT]
    assert not loop.alarms


def test_a_sealed_message_comes_through_a_network_that_loses_and_ends_that_die() -> None:
    faults = Faults(loss=0.1, repeat=0.1, delay_s=0.02, crash=0.01, until_s=120.0)
    for seed in range(3):
        loop = Looked("sealed", seed, faults)
        history = loop.run(until=partial(arrived, loop), steps=3000)
        assert history.inbox == [TEXT], seed
        assert history.crashes > 0
        assert not loop.alarms
        carried = [t for t in history.plant.values() if t.served]
        assert len(carried) >= len(TEXT) * 4
        for t in history.plant.values():
            assert bool(t.served) == (t.message_symbol >= 0)
            assert not t.served or t.digits not in (None, NOWHERE)


def test_a_seed_gives_the_same_keys_and_so_the_same_run() -> None:
    """Nonces came from the operating system, so that no seeded run with keys was ever repeated."""
    faults = Faults(loss=0.05, repeat=0.1, delay_s=0.02, crash=0.01, until_s=30.0)
    first, second = (Looked("sealed", 4, faults) for _ in range(2))
    for loop in (first, second):
        loop.run(steps=150)
    assert any(t.served for t in first.history.plant.values())
    assert first.sent == second.sent
    assert first.history.plant == second.history.plant
    other = Looked("sealed", 5, faults)
    other.run(steps=60)
    assert first.sent[: len(other.sent)] != other.sent
