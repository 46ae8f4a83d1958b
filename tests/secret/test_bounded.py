"""What a long run leaves in memory: after many blocks no structure is larger than after a few."""

from plant_service.punctuality import Punctuality
from tests.support.held_memory import kept
from tests.support.line import keyed_rules
from tests.support.pair import SIDES, LinePair

ELSEWHERE = (LinePair, Punctuality)
"""A plant's punctuality is that of its newest thousand steps."""


def measured(world: LinePair) -> dict[str, tuple[int, int]]:
    found = {f"the {side}'s end": kept([world.ends[side].endpoint], ELSEWHERE) for side in SIDES}
    found |= {f"the {side}'s journal": kept([world.journals[side]], (LinePair,)) for side in SIDES}
    return found


def test_ends_and_journals_hold_no_more_after_many_blocks() -> None:
    """Nobody takes of the key stream here, so it is as long as it gets."""
    world = LinePair(keyed_rules())
    world.well(200)
    blocks, most = len(world.onlooker.blocks), dict[str, tuple[int, int]]()
    for _ in range(60):  # within a block there is more, and then less
        world.next()
        for name, (objects, size) in measured(world).items():
            before = most.get(name, (0, 0))
            most[name] = max(before[0], objects), max(before[1], size)
    world.well(2400)
    assert len(world.onlooker.blocks) > 10 * blocks
    for name, (objects, size) in measured(world).items():
        assert objects < 1.1 * most[name][0], name
        assert size < 1.1 * most[name][1], name
    world.close()
