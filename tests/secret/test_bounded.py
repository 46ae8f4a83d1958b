"""What a long run leaves in memory: after many blocks no structure is larger than after a few."""

from dataclasses import replace

from protocol.secret.blocks import Schedule
from protocol.secret.bound import Assumption
from tests.support.held_memory import kept
from tests.support.keyed_link import SIDES, World
from tests.support.line_plant import line_rules

RULES = replace(
    line_rules(alpha=4.0, largest_input=1e9),
    schedule=Schedule(Assumption(0.95, eps_sec=1e-2), first=3, largest=6),
)


def measured(world: World) -> dict[str, tuple[int, int]]:
    found = {f"the {side}'s end": kept([world.ends[side]], (World,)) for side in SIDES}
    found |= {
        f"the {side}'s keeper": kept([vars(world.key_makers[side])], (World,)) for side in SIDES
    }
    found |= {f"the {side}'s journal": kept([world.journals[side]], (World,)) for side in SIDES}
    return found


def test_ends_keepers_and_journals_hold_no_more_after_many_blocks() -> None:
    world = World(RULES)
    world.well(200)
    blocks, most = len(world.stores["plant"].blocks()), dict[str, tuple[int, int]]()
    for _ in range(6):  # within a block there is more, and then less
        world.well(7)
        for name, (objects, size) in measured(world).items():
            before = most.get(name, (0, 0))
            most[name] = max(before[0], objects), max(before[1], size)
    world.well(4000)
    assert len(world.stores["plant"].blocks()) > 10 * blocks
    for name, (objects, size) in measured(world).items():
        assert objects < 1.1 * most[name][0], name
        assert size < 1.1 * most[name][1], name
    world.close()
