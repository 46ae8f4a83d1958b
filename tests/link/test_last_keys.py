"""A plant that has made its steps waits for key blocks that are whole, within a bound."""

from dataclasses import replace

import pytest

from plant_service.core import LAST_KEYS_S, PlantCore
from protocol.messages import BlockAnnouncement, Message
from protocol.secret.blocks import Schedule
from protocol.secret.bound import Assumption
from protocol.secret.records import Side
from runtime.errors import DONE
from runtime.perform import perform
from tests.support.keyed_link import SIDES, World
from tests.support.line_plant import line_rules

RULES = replace(
    line_rules(alpha=4.0, largest_input=1e9),
    schedule=Schedule(Assumption(0.95, eps_sec=1e-2), first=3, largest=6),
)
STEPS = 40


class Ending(World):
    """A world whose plant makes so many steps; ``deaf`` lets no word of the end pass."""

    deaf = False

    steps = STEPS

    @property
    def end(self) -> PlantCore:
        endpoint = self.ends["plant"]
        assert isinstance(endpoint, PlantCore)
        return endpoint

    def published(self, side: Side, kind: type[Message], payload: bytes) -> None:
        if not (self.deaf and kind is BlockAnnouncement):
            super().published(side, kind, payload)

    def goes_on(self, *, key_makers: bool) -> None:
        """Everybody hears everything; keepers work, or are behind."""
        for side in SIDES:
            self.wake(side)
            while self.bag[side]:
                kind, payload = self.bag[side].pop(0)
                if kind in self.ends[side].hears:
                    self.carry_out(side, self.ends[side].receive(kind, payload, self.now))
            if key_makers:
                self.keeps(side)
                self.told(side)


@pytest.fixture
def world() -> Ending:
    return Ending(RULES, perform, period_s=0.5)


def ended(world: Ending) -> Ending:
    """Once all steps are made and none of its keepers has done a thing."""
    for _ in range(3000):
        world.goes_on(key_makers=False)
        if world.end.record.k == STEPS:
            break
    assert world.end.record.k == STEPS
    assert world.end.status is not None
    return world


def test_blocks_that_are_whole_are_confirmed_at_both_ends_before_it_ends(world: Ending) -> None:
    ended(world)
    whole = world.end.keying.waiting
    assert whole >= 5
    begun = world.now
    while world.end.code is None:
        world.goes_on(key_makers=True)
        assert world.now < begun + LAST_KEYS_S
    assert world.end.code == DONE
    states = [[b.state for b in world.stores[side].blocks()] for side in SIDES]
    assert states[0][:whole] == states[1][:whole] == ["confirmed"] * whole
    world.close()


def test_it_does_not_wait_for_ever_and_says_how_many_wait(world: Ending) -> None:
    world.deaf = True
    ended(world)
    begun = world.now
    while world.end.code is None:
        world.goes_on(key_makers=False)
        assert world.now < begun + 2 * LAST_KEYS_S
    assert world.now >= begun + LAST_KEYS_S
    notices = [n.text for n in world.end.stop(world.now).notices]
    (told,) = [text for text in notices if text.startswith("key blocks that wait")]
    assert f": {world.end.keying.waiting};" in told
    world.close()
