"""A direction of the network: what is lost and when the rest arrives is each message's own fate."""

from itertools import accumulate, pairwise
from typing import Any

import pytest

from protocol.link.channel import COPIES, Channel
from protocol.link.networked import Networked
from protocol.messages import ControllerHello, Offer
from protocol.scenario.network import ChannelTable
from tests.support.hearing import Hearing

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


def test_after_many_copies_the_state_is_that_of_the_step_after() -> None:
    lost = [channel(**BAD_HALF).arrival(k, 0.0) is None for k in range(40)]
    assert any(a and not b for a, b in pairwise(lost))
    way = channel(**BAD_HALF)
    for k in range(38):
        copies = [way.arrival(k, 0.0) is None for _ in range(2 * COPIES + 1)]
        assert copies == [*[lost[k]] * COPIES, *[lost[k + 1]] * COPIES, lost[k + 2]]


def test_a_fate_is_the_same_whatever_was_sent_before() -> None:
    table = BAD_HALF | JITTER | {"loss": 0.3}
    forth = [channel(**table).arrival(k, 0.0) for k in range(30)]
    way = channel(**table)
    back = [way.arrival(k, 0.0) for k in reversed(range(30))]
    assert back[::-1] == forth
    assert 5 < forth.count(None) < 25


# --- an end behind it -----------------------------------------------------------------------------


def offer(k: int) -> bytes:
    return Offer(session="1" * 16, k=k, candidates=((0.0,), (1.0,)), cipher=0).wire()


@pytest.mark.parametrize("due", [0.5, 20.0])
def test_an_offer_is_heard_when_it_arrives_and_a_hello_at_once(due: float) -> None:
    end = Hearing(due)
    peer = Networked(end, Offer, channel(delay="constant", delay_s=2.0))
    for k in range(3):
        peer.receive(Offer, offer(k), float(k))
    assert end.heard == []
    peer.receive(ControllerHello, b"hello", 2.0)
    assert end.heard.pop() == (2.0, ControllerHello, b"hello")
    while len(end.heard) < 3:
        peer.wake(peer.wake_at())
    assert end.heard == [(k + 2.0, Offer, offer(k)) for k in range(3)]
    assert end.woken == ([0.5] if due < 1 else []), "what was due before it goes first"
