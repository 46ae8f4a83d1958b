"""A message that leaves more often than was claimed counts for no key; one that does not, does."""

from typing import Any

import pytest

from protocol.link.records import Side
from protocol.messages import Measurement, Offer
from protocol.secret.blocks import schedule_of
from protocol.secret.bound import Assumption
from tests.support.keyed_pair import KeyedPair, keyed_rules
from tests.support.mail import Mail
from tests.support.pair import SIDES, Name

CLAIM = Assumption(0.7, appearances=2)


class Watched(KeyedPair):
    """A world that notes which copies its ends send first, by side."""

    def __init__(self) -> None:
        self.sent: dict[Name, list[int]] = {side: [] for side in SIDES}
        super().__init__(keyed_rules(schedule=schedule_of(CLAIM)), period_s=0.3)

    def said(self, side: Name, message: Mail) -> None:
        if message.kind in (Measurement, Offer):
            said = message.kind.model_validate_json(message.payload)
            assert isinstance(said, Measurement | Offer)
            self.sent[side].append(said.copy_number)
        super().said(side, message)

    def appear(self, side: Side, count: int) -> None:
        self.do(side, lambda _: self.ends[side].endpoint.appear(count))

    def keys(self) -> tuple[int, int]:
        plant, controller = (sum(self.confirmed[side].values()) for side in SIDES)
        return plant, controller


@pytest.mark.parametrize("side", SIDES)
def test_keys_stop_while_a_message_leaves_too_often_and_go_on_after(side: Side) -> None:
    world = Watched()
    for one in SIDES:
        world.appear(one, 2)
    world.well(300)
    before = world.keys()
    assert min(before) > 0

    world.appear(side, 3)
    world.sent[side].clear()
    world.well(300)  # several blocks
    crowded = world.keys()
    assert set(world.sent[side]) == {1}
    world.well(300)
    assert world.keys() == crowded
    assert "leaves 3 times, and keys.appearances = 2" in told(world, side)

    world.appear(side, 2)
    world.well(900)
    assert min(world.keys()) > min(crowded)
    assert "appearances" not in told(world, side)
    world.agree()
    world.close()


def told(world: Watched, side: Side) -> str:
    keyed: Any = world.ends[side].endpoint
    stopped: str = keyed.state.keys.status_fields()["keys_stopped"]
    return stopped


def test_a_process_that_dies_while_messages_leave_too_often_sends_no_copy_0() -> None:
    world = Watched()
    for side in SIDES:
        world.appear(side, 3)
    for side in SIDES:
        world.well(20, victim=side, before="publishing")
        world.appear(side, 3)
    world.sent["plant"].clear()
    world.sent["controller"].clear()
    world.well(50)
    assert set(world.sent["plant"]) == set(world.sent["controller"]) == {1}
    assert world.keys() == (0, 0)
    world.close()
