"""A plant that has made its steps waits for key blocks that are whole, within a bound."""

import pytest

from plant_service.core import LAST_KEYS_S
from protocol.messages import BlockAnnouncement
from runtime.errors import DONE
from tests.support.keyed_ends import KeyedEnds, keyed_rules
from tests.support.mail import Mail
from tests.support.two_ends import SIDES, Name

STEPS = 40


class Ending(KeyedEnds):
    """Ends whose plant makes so many steps; ``deaf`` lets no word of the end pass."""

    deaf = False

    def said(self, side: Name, message: Mail) -> None:
        if not (self.deaf and message.kind is BlockAnnouncement):
            super().said(side, message)


@pytest.fixture
def world() -> Ending:
    return Ending(keyed_rules(), steps=STEPS)


def ended(world: Ending) -> Ending:
    """Once all steps are made and none of its keepers has done a thing."""
    for _ in range(3000):
        world.step(key_makers=False)
        if world.plant.record.k == STEPS:
            break
    assert world.plant.record.k == STEPS
    assert world.plant.status is not None
    return world


def test_blocks_that_are_whole_are_confirmed_at_both_ends_before_it_ends(world: Ending) -> None:
    ended(world)
    whole = world.plant.keying.waiting
    assert whole >= 5
    begun = world.now
    while world.plant.code is None:
        world.step(key_makers=True)
        assert world.now < begun + LAST_KEYS_S
    assert world.plant.code == DONE
    states = [[b.state for b in world.stores[side].blocks()] for side in SIDES]
    assert states[0][:whole] == states[1][:whole] == ["confirmed"] * whole
    world.close()


def test_it_does_not_wait_for_ever_and_says_how_many_wait(world: Ending) -> None:
    world.deaf = True
    ended(world)
    begun = world.now
    while world.plant.code is None:
        world.step(key_makers=False)
        assert world.now < begun + 2 * LAST_KEYS_S
    assert world.now >= begun + LAST_KEYS_S
    notices = [n.text for n in world.plant.stop(world.now).notices]
    (told,) = [text for text in notices if text.startswith("key blocks that wait")]
    assert f": {world.plant.keying.waiting};" in told
    world.close()
