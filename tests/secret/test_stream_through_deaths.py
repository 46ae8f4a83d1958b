"""The key stream through both real ends as a state machine, and wrong ones that it catches.

Keys are short here, five digits each, so that the stream runs dry and is filled all the time.
"""

from collections.abc import Callable, Iterator

import pytest
from hypothesis import HealthCheck, settings

from controller_service import chooser
from protocol.link.effects import Save
from protocol.link.events import Event
from protocol.link.session import CountedTransition
from protocol.schemes.sealed import Sealed
from protocol.secret import key_digits, stream
from protocol.secret.stream import NOTHING_HELD, NOWHERE, Held, Keys, KeyStream, Position
from tests.secret.test_keyed_link import KeyedLink, shaken
from tests.support.broken import broken
from tests.support.keyed_pair import KeyedPair, keyed_rules
from tests.support.pair import SIDES, Name
from tests.support.safety import BEYOND, first_held
from tests.support.size import size

COINS = keyed_rules(keyed=True)
SEALED = keyed_rules(keyed=True, scheme=Sealed(2))
DIGITS = 5
PAYLOADS = tuple(bytes([at]) for at in range(200))


@pytest.fixture(autouse=True)
def short_keys() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stream, "digits", lambda k, size: key_digits.digits(k, size)[:DIGITS])
        yield


class SealedEnds(KeyedPair):
    """Ends that send messages under the key stream: each arrives once, in order."""

    def __init__(self) -> None:
        self.received: list[bytes] = []
        super().__init__(SEALED, payloads=PAYLOADS)

    def saved(self, side: Name, save: Save) -> None:
        super().saved(side, save)
        if save.received is not None:
            self.received.append(save.received)
            assert self.received == list(PAYLOADS[: len(self.received)])

    def traced(self, side: Name, event: Event) -> None:
        super().traced(side, event)
        refused = isinstance(event, CountedTransition) and event.refused
        assert not refused, "a frame arrived broken"


class KeyedCoinLink(KeyedLink):
    @staticmethod
    def begun() -> KeyedPair:
        return KeyedPair(COINS)


class SealedLink(KeyedLink):
    @staticmethod
    def begun() -> KeyedPair:
        return SealedEnds()


LIMITS = settings(
    max_examples=size(8, 20),
    stateful_step_count=40,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)
TestKeyedCoinLink = KeyedCoinLink.TestCase
TestKeyedCoinLink.settings = LIMITS
TestSealedLink = SealedLink.TestCase
TestSealedLink.settings = LIMITS


@pytest.mark.parametrize("begun", [KeyedCoinLink.begun, SealedEnds])
def test_digits_serve_once_and_are_gone_through_deaths(begun: Callable[[], KeyedPair]) -> None:
    world = shaken(begun(), 3)
    served = world.digits.served
    assert len(served) > 50
    assert len(world.digits.watched) > 50
    record = world.journals["plant"].load().record
    assert record is not None
    of_session = sorted(at for session, at in served if session == record.session.id)
    newest = of_session[-3]  # a digit goes with the save of the next step, at the controller later
    for side in SIDES:
        first = first_held(world.held(side))
        assert newest <= first < BEYOND, "a digit that has served is still in a journal"
    world.close()


def test_sealed_messages_arrive_through_deaths() -> None:
    world = SealedEnds()
    shaken(world, 5, rounds=150)
    assert len(world.received) > 2
    world.close()


# --- the wrong ones -------------------------------------------------------------------------------


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
    def keeps(self: KeyStream, position: Position) -> tuple[Keys, ...]:
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
            test_digits_serve_once_and_are_gone_through_deaths(SealedEnds)
            test_sealed_messages_arrive_through_deaths()
            shaken(SealedEnds(), seed).close()
