"""Both real ends that make and spend keys as a state machine, and wrong ones that it catches.

hypothesis plays the network, the reaper and whoever extracts key blocks. Keys are short here, five
digits each, so that the stream runs dry and is filled all the time.
"""

from collections.abc import Callable, Iterator
from random import Random

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from controller_service import chooser
from protocol.link.records import Side
from protocol.schemes.sealed import Sealed
from protocol.secret.stream import NOTHING_HELD, NOWHERE, BlockKeys, Held, KeyStream, Position
from runtime.perform import CrashPoint
from tests.support.broken import broken, hasty
from tests.support.line import keyed_rules
from tests.support.pair import SIDES, LinePair
from tests.support.safety import BEYOND, first_held
from tests.support.short_keys import short_keys
from tests.support.size import size

SIDE = st.sampled_from(SIDES)
POINTS: tuple[CrashPoint, ...] = ("saving", "publishing", "tracing", "extracting")
POINT = st.sampled_from(POINTS)
PLACES = st.lists(st.integers(0, 11), min_size=1, max_size=6)

PAYLOADS = tuple(bytes([at]) for at in range(200))


@pytest.fixture(autouse=True)
def five_digits() -> Iterator[None]:
    with short_keys(5):
        yield


def made() -> LinePair:
    """Keys are made, and nobody spends them."""
    return LinePair(keyed_rules())


def coins() -> LinePair:
    """Keys choose the plant's coin."""
    return LinePair(keyed_rules(keyed=True))


def sealed() -> LinePair:
    """And messages travel under the key stream: each arrives once, in order."""
    return LinePair(keyed_rules(keyed=True, scheme=Sealed(2)), payloads=PAYLOADS)


class KeyedLink(RuleBasedStateMachine):
    begun = staticmethod(made)

    def __init__(self) -> None:
        super().__init__()
        self.world = self.begun()

    def teardown(self) -> None:
        self.world.close()

    @rule(side=SIDE, places=PLACES)
    def messages_arrive(self, side: Side, places: list[int]) -> None:
        for place in places:
            self.world.deliver(side, place)

    @rule(side=SIDE)
    def time_passes(self, side: Side) -> None:
        self.world.wake(side)

    @rule(side=SIDE)
    def a_block_is_extracted(self, side: Side) -> None:
        self.world.extract(side)

    @rule(side=SIDE)
    def an_end_is_told(self, side: Side) -> None:
        self.world.told(side)

    @rule(side=SIDE, before=POINT)
    def a_process_will_die(self, side: Side, before: CrashPoint) -> None:
        self.world.crash_at(side, before)

    @rule(side=SIDE)
    def a_process_dies(self, side: Side) -> None:
        self.world.die(side)

    @rule(rounds=st.integers(5, 60))
    def all_is_well_for_a_while(self, rounds: int) -> None:
        self.world.well(rounds)

    @rule(rounds=st.integers(10, 60), victim=SIDE, before=POINT)
    def all_is_well_but_for_one(self, rounds: int, victim: Side, before: CrashPoint) -> None:
        self.world.well(rounds, victim, before)

    @invariant()
    def both_hold_the_same_and_each_message_arrives_once(self) -> None:
        self.world.agree()
        assert self.world.received == list(PAYLOADS[: len(self.world.received)])


class KeyedCoinLink(KeyedLink):
    begun = staticmethod(coins)


class SealedLink(KeyedLink):
    begun = staticmethod(sealed)


TestKeyedLink = KeyedLink.TestCase
TestKeyedLink.settings = settings(
    max_examples=size(8, 30),
    stateful_step_count=40,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)
TestKeyedCoinLink = KeyedCoinLink.TestCase
TestSealedLink = SealedLink.TestCase
TestKeyedCoinLink.settings = TestSealedLink.settings = TestKeyedLink.settings


def test_both_ends_confirm_the_same_blocks_while_all_is_well() -> None:
    world = made()
    world.well(900)
    ends = [world.journals[side].load().record for side in SIDES]
    assert all(record is not None and record.keys.confirmed > 20 for record in ends)
    assert min(world.onlooker.blocks.values()) >= 1
    assert len(world.journals["plant"].load().rows) < 12
    world.close()


def shaken(world: LinePair, seed: int, rounds: int = 60) -> LinePair:
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


@pytest.mark.parametrize("begun", [coins, sealed])
def test_digits_serve_once_and_are_gone_through_deaths(begun: Callable[[], LinePair]) -> None:
    world = shaken(begun(), 3)
    served = world.onlooker.digits.served
    assert len(served) > 50
    assert len(world.onlooker.digits.watched) > 50
    record = world.journals["plant"].load().record
    assert record is not None
    of_session = sorted(at for session, at in served if session == record.session.id)
    newest = of_session[-3]  # a digit goes with the save of the next step, at the controller later
    for side in SIDES:
        first = first_held(world.held(side))
        assert newest <= first < BEYOND, "a digit that has served is still in a journal"
    world.close()


def test_sealed_messages_arrive_through_deaths() -> None:
    world = sealed()
    shaken(world, 5, rounds=150)
    assert world.received == list(PAYLOADS[: len(world.received)])
    assert len(world.received) > 2
    world.close()


# --- the wrong ones -------------------------------------------------------------------------------


class Hasty(LinePair):
    """A shell that sends before it saves."""

    performer = staticmethod(hasty)


def dies_while_writing(world: LinePair) -> None:
    """The controller, over and over; some of what it writes is a step."""
    world.well(200)
    for _ in range(20):
        world.well(20, "controller", "saving")


def test_sending_before_saving_is_caught_and_saving_first_answers_a_step_once() -> None:
    """The step waits until the controller is back, and is answered a second time."""
    with pytest.raises(AssertionError, match="copy 0 left twice"):
        dies_while_writing(Hasty(keyed_rules(), period_s=3.0))
    world = LinePair(keyed_rules(), period_s=3.0)
    dies_while_writing(world)
    assert world.deaths == 20
    world.close()


def the_position_does_not_move_on(patch: pytest.MonkeyPatch) -> None:
    name = KeyStream.name

    def same(self: KeyStream, *of: int) -> Position:
        after = self._after
        named = name(self, *of)
        self._after = after
        return named

    patch.setattr(KeyStream, "name", same)


def a_new_process_forgets_what_it_named(patch: pytest.MonkeyPatch) -> None:
    init = KeyStream.__init__

    def begins(
        self: KeyStream, size: int, held: Held = NOTHING_HELD, after: Position = NOWHERE
    ) -> None:
        init(self, size, held)

    patch.setattr(KeyStream, "__init__", begins)
    nothing_is_erased(patch)


def nothing_is_erased(patch: pytest.MonkeyPatch) -> None:
    def keeps(self: KeyStream, position: Position) -> tuple[BlockKeys, ...]:
        return ()

    patch.setattr(KeyStream, "drop_before", keeps)


def a_controller_takes_no_notice_of_what_was_used(patch: pytest.MonkeyPatch) -> None:
    broken(patch, chooser, "if digits or not rules.scheme.from_stream:", "if True:")


WRONG: list[Callable[[pytest.MonkeyPatch], None]] = [
    the_position_does_not_move_on,
    a_new_process_forgets_what_it_named,
    nothing_is_erased,
    a_controller_takes_no_notice_of_what_was_used,
]


@pytest.mark.wrong_on_purpose
@pytest.mark.parametrize("wrong", WRONG)
def test_a_wrong_one_is_caught(wrong: Callable[[pytest.MonkeyPatch], None]) -> None:
    with pytest.MonkeyPatch.context() as patch, pytest.raises(AssertionError):
        wrong(patch)
        for seed in range(8):
            test_digits_serve_once_and_are_gone_through_deaths(sealed)
            test_sealed_messages_arrive_through_deaths()
            shaken(sealed(), seed).close()
