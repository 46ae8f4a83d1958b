"""A direction of the network: what is lost and when the rest arrives is each message's own fate."""

import random
from itertools import accumulate
from math import inf, nextafter
from typing import Any, ClassVar

import pytest

from protocol.fates import Fates
from protocol.link.channel import Channel
from protocol.link.effects import Effects
from protocol.link.endpoint import Endpoint
from protocol.messages import Message, Offer
from protocol.scenario.network import ChannelTable

JITTER: dict[str, Any] = {"delay": "uniform", "delay_s": 1.0, "jitter_s": 1.0}
BAD_HALF: dict[str, Any] = {"loss_bad": 1.0, "to_bad": 0.4, "to_good": 0.5}
"""A state that loses everything, in some of the steps; in the others nothing is lost."""


def channel(**table: Any) -> Channel:
    return Channel(ChannelTable(**table), "1 to_plant")


def arrivals(way: Channel, steps: int = 50) -> list[float]:
    """Of one message a step, which leave ten a second."""
    found = [way.arrival(k, k / 10) for k in range(steps)]
    return [at for at in found if at is not None]


def test_a_message_may_overtake_another_unless_the_way_keeps_their_order() -> None:
    free, ordered = arrivals(channel(**JITTER)), arrivals(channel(**JITTER, reordering=False))
    assert free != sorted(free)
    assert ordered == list(accumulate(free, max)), "each waits for those before it, and no longer"


def test_a_step_that_loses_everything_loses_all_its_copies() -> None:
    way = channel(**BAD_HALF)
    for k in range(40):
        lost = {way.arrival(k, 0.0) is None for _ in range(3)}
        assert len(lost) == 1, k


FATES = Fates("1 to_plant")
"""Of the channel's messages: what is lost by the first number, late by the second."""


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_a_delay_is_the_one_that_the_second_number_stands_for(scale: float) -> None:
    def delays(**table: Any) -> list[float | None]:
        way = Channel(ChannelTable(**table), "1 to_plant", scale)
        return [way.arrival(k, 0.0) for k in (3, 4, 4)]

    late = [FATES.at(k, copy)[1] for k, copy in ((3, 0), (4, 0), (4, 1))]
    assert delays() == [0.0] * 3
    assert delays(delay_s=0.25) == [scale * 0.25] * 3
    uniform = [scale * (3.0 + (2.0 * u - 1.0) * 2.0) for u in late]
    assert delays(delay="uniform", delay_s=3.0, jitter_s=2.0) == uniform
    gamma = [scale * random.Random(u).gammavariate(4.0, 0.25) for u in late]
    assert delays(delay="gamma", delay_s=1.0, jitter_s=0.5) == gamma


def test_a_message_is_lost_where_its_number_is_below_the_loss() -> None:
    lost, _ = FATES.at(5, 0)
    assert channel(loss=lost).arrival(5, 0.0) == 0.0
    assert channel(loss=nextafter(lost, 1)).arrival(5, 0.0) is None


def test_a_way_without_a_bad_state_has_its_loss_in_every_step() -> None:
    way = channel(loss=0.5)
    lost = [way.arrival(k, 0.0) is None for k in range(60)]
    assert lost == [FATES.at(k, 0)[0] < 0.5 for k in range(60)]


class Hearing(Endpoint):
    """An end that keeps what it hears, and when."""

    receives: ClassVar[tuple[type[Message], ...]] = (Offer,)
    sends: ClassVar[tuple[type[Message], ...]] = ()

    def __init__(self, channel: Channel) -> None:
        super().__init__("1" * 16, channel)
        self.heard: list[tuple[float, int]] = []

    def hear(self, message: Message, now: float) -> Effects:
        assert isinstance(message, Offer)
        self.heard.append((now, message.k))
        return ()

    def due_at(self) -> float:
        return inf

    def act(self, now: float) -> Effects:
        return ()

    start = stop = act


def test_an_offer_is_heard_when_it_arrives_and_what_is_lost_never() -> None:
    heard = {}
    ways = {"late": channel(delay_s=2.0), "free": channel(), "no": channel(loss=1.0)}
    for name, way in ways.items():
        end = Hearing(way)
        for k in range(3):
            said = Offer(session="1" * 16, k=k, candidates=((0.0,), (1.0,)), cipher=0)
            end.receive(Offer, said.wire(), float(k))
        while end.wake_at() < inf:
            end.wake(end.wake_at())
        heard[name] = end.heard
    assert heard["late"] == [(k + 2.0, k) for k in range(3)]
    assert heard["free"] == [(float(k), k) for k in range(3)]
    assert heard["no"] == []
