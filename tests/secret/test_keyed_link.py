"""The two real ends that make keys as a state machine, and wrong ones that it must catch.

hypothesis plays the network, the reaper and whoever extracts key blocks.
"""

from collections.abc import Callable
from random import Random

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from controller_service import chooser
from plant_service import stepper
from protocol.link import distiller as distiller_module
from protocol.link.distiller import Distiller
from protocol.link.records import Side
from protocol.secret.nonces import Contribution, contribution_of
from runtime.perform import CrashPoint
from tests.support.asked import hasty
from tests.support.broken import FIRST_COPY, broken
from tests.support.keyed_pair import KeyedPair, keyed_rules
from tests.support.pair import SIDES
from tests.support.size import size

SIDE = st.sampled_from(SIDES)
POINTS: tuple[CrashPoint, ...] = ("saving", "publishing", "tracing", "extracting")
POINT = st.sampled_from(POINTS)
PLACE = st.integers(0, 11)


class KeyedLink(RuleBasedStateMachine):
    """Drives a world; subclasses say which."""

    def __init__(self) -> None:
        super().__init__()
        self.world = self.begun()

    @staticmethod
    def begun() -> KeyedPair:
        return KeyedPair(keyed_rules())

    def teardown(self) -> None:
        self.world.close()

    @rule(side=SIDE, places=st.lists(PLACE, min_size=1, max_size=6))
    def messages_arrive(self, side: str, places: list[int]) -> None:
        for place in places:
            self.world.deliver(side, place)  # type: ignore[arg-type]

    @rule(side=SIDE)
    def time_passes(self, side: str) -> None:
        self.world.wake(side)  # type: ignore[arg-type]

    @rule(side=SIDE)
    def a_block_is_extracted(self, side: str) -> None:
        self.world.extract(side)  # type: ignore[arg-type]

    @rule(side=SIDE)
    def an_end_is_told(self, side: str) -> None:
        self.world.told(side)  # type: ignore[arg-type]

    @rule(side=SIDE, before=POINT)
    def a_process_will_die(self, side: str, before: str) -> None:
        self.world.crash_at(side, before)  # type: ignore[arg-type]

    @rule(side=SIDE)
    def a_process_dies(self, side: str) -> None:
        self.world.die(side)  # type: ignore[arg-type]

    @rule(rounds=st.integers(5, 60))
    def all_is_well_for_a_while(self, rounds: int) -> None:
        self.world.well(rounds)

    @rule(rounds=st.integers(10, 60), victim=SIDE, before=POINT)
    def all_is_well_but_for_one(self, rounds: int, victim: str, before: str) -> None:
        self.world.well(rounds, victim, before)  # type: ignore[arg-type]

    @invariant()
    def both_hold_the_same(self) -> None:
        self.world.agree()


class KeyedLinkOnDisk(KeyedLink):
    """Journals as the services have them, opened anew from their files after each death."""

    @staticmethod
    def begun() -> KeyedPair:
        return KeyedPair(keyed_rules(), on_disk=True)


TestKeyedLink = KeyedLink.TestCase
TestKeyedLink.settings = settings(
    max_examples=size(12, 30),
    stateful_step_count=40,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)
TestKeyedLinkOnDisk = pytest.mark.slow(KeyedLinkOnDisk.TestCase)
TestKeyedLinkOnDisk.settings = settings(TestKeyedLink.settings, max_examples=size(4, 10))


def test_both_ends_confirm_the_same_blocks_while_all_is_well() -> None:
    world = KeyedPair(keyed_rules())
    world.well(900)
    plant, controller = (world.confirmed[side] for side in SIDES)
    assert len(plant) > 20
    assert all(keys >= 1 for keys in plant.values())
    shared = plant.keys() & controller.keys()
    assert len(shared) >= len(plant) - 1
    assert all(plant[at] == controller[at] for at in shared)
    assert len(world.journals["plant"].load().rows) < 12
    world.close()


def shaken(world: KeyedPair, seed: int, rounds: int = 60) -> KeyedPair:
    """A world whose ends die at any point, over and over, while all else is well."""
    draw = Random(seed)
    world.well(300)
    for _ in range(rounds):
        side = draw.choice(SIDES)
        world.well(draw.randrange(4, 16), side, after=draw.randrange(6))
        if draw.random() < 0.2:
            world.die(side)
    world.well(60)
    return world


# --- the wrong ones -------------------------------------------------------------------------------


class Hasty(KeyedPair):
    """A shell that sends before it saves."""

    performer = staticmethod(hasty)


def same_nonce_in_repeats(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(Distiller, "again", lambda _, offer: offer.model_copy(update={"copy_number": 1}))


def copy_0_again_after_a_death(patch: pytest.MonkeyPatch) -> None:
    broken(patch, stepper, *FIRST_COPY)


def wrong_heard(patch: pytest.MonkeyPatch) -> None:
    broken(patch, chooser, "heard=measurement.copy_number,", "heard=0,")


def nonces_swapped(patch: pytest.MonkeyPatch) -> None:
    count = 0

    def wrong(**of: object) -> Contribution:
        nonlocal count
        count += 1
        contribution = contribution_of(**of)  # type: ignore[arg-type]
        if count % 2:  # one end of the two, mostly
            return contribution._replace(
                offer=contribution.measurement, measurement=contribution.offer
            )
        return contribution

    patch.setattr(distiller_module, "contribution_of", wrong)


WRONG: dict[str, Callable[[pytest.MonkeyPatch], None]] = {
    "repeats repeat the nonce": same_nonce_in_repeats,
    "copy 0 again after a death": copy_0_again_after_a_death,
    "the wrong copy heard": wrong_heard,
    "nonces swapped": nonces_swapped,
}


ROUNDS = 400
"""Schedules that a wrong end has, to be caught in one; most are in the first few."""


def stagger(world: KeyedPair, random: Random, side: Side) -> None:
    """Something happens to one side, or to both."""
    actions: list[Callable[[], None]] = [
        lambda: world.well(random.randrange(5, 60)),
        lambda: world.well(random.randrange(5, 60), side, random.choice(POINTS)),
        lambda: world.deliver(side, random.randrange(12)),
        lambda: world.wake(side),
        lambda: world.extract(side),
        lambda: world.told(side),
        lambda: world.die(side),
    ]
    random.choice(actions)()


def wander(seed: int) -> None:
    """One random schedule, from its seed: faster than hypothesis, and the same whatever changes."""
    random = Random(seed)
    world = KeyedPair(keyed_rules())
    try:
        for _ in range(random.randrange(10, 40)):
            stagger(world, random, random.choice(SIDES))
            world.agree()
    finally:
        world.close()


def caught() -> bool:
    for seed in range(ROUNDS):
        try:
            wander(seed)
        except AssertionError:
            return True
    return False


def dies_while_writing(world: KeyedPair) -> None:
    """The controller, over and over; some of what it writes is a step."""
    for _ in range(20):
        world.well(20, "controller", "saving")


@pytest.mark.wrong_on_purpose
def test_sending_before_saving_is_caught() -> None:
    """The step waits until the controller is back, and is answered a second time."""
    world = Hasty(keyed_rules(), period_s=3.0)
    world.well(200)
    with pytest.raises(AssertionError, match="copy 0 left twice"):
        dies_while_writing(world)
    world.close()


def test_saving_before_sending_answers_the_same_step_once() -> None:
    world = KeyedPair(keyed_rules(), period_s=3.0)
    world.well(200)
    dies_while_writing(world)
    assert world.deaths == 20
    world.close()
