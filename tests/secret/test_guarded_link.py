"""Tagged and coded messages through both real ends and stores, through deaths; and wrong ones."""

from collections.abc import Callable, Iterator
from random import Random

import pytest
from hypothesis import HealthCheck, settings

from protocol.defence.base import Defence
from protocol.defence.coding import Coding
from protocol.defence.mac import Mac
from protocol.link import guarded
from protocol.link.guard import ANEW, Guard, Promise
from protocol.link.records import ReceiverRecord
from protocol.messages import Measurement
from protocol.secret.records import Side
from protocol.secret.tasks import Batch
from runtime.journal import ControllerJournal, PlantJournal
from runtime.keys import guards
from runtime.keys.store import KeyStore
from tests.secret.test_keyed_link import KeyedLink, shaken
from tests.support.broken import broken
from tests.support.journals import contents, fill
from tests.support.keyed_ends import KeyedEnds, keyed_rules
from tests.support.once import Copies
from tests.support.size import size
from tests.support.two_ends import SIDES

GUARDS: list[Callable[[int, int], Defence]] = [Mac, Coding]


@pytest.fixture(autouse=True)
def soon() -> Iterator[None]:
    """Keys are short-lived, and come when they are needed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(guarded, "AHEAD", 4)
        patch.setattr(guarded, "MARGIN", 2)
        yield


def guarded_ends(guard: Defence) -> KeyedEnds:
    return KeyedEnds(keyed_rules(), guard=guard)


class GuardedLink(KeyedLink):
    @staticmethod
    def begun() -> KeyedEnds:
        return guarded_ends(Mac(1, 2))


class CodedLink(KeyedLink):
    @staticmethod
    def begun() -> KeyedEnds:
        return guarded_ends(Coding(1, 2))


TestGuardedLink = pytest.mark.slow(GuardedLink.TestCase)
TestCodedLink = pytest.mark.slow(CodedLink.TestCase)
TestGuardedLink.settings = TestCodedLink.settings = settings(
    max_examples=6,
    stateful_step_count=25,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)


@pytest.mark.parametrize("made", GUARDS)
def test_messages_are_guarded_through_deaths_and_no_slot_serves_two(
    made: Callable[[int, int], Defence],
) -> None:
    guard = made(1, 2)
    world = shaken(guarded_ends(guard), 3, 40)
    topics = {topic for topic, _, _ in world.slots.served}
    assert topics == ({"measurement", "offer"} if guard.tags else {"measurement"})
    assert len(world.slots.served) > 60
    assert world.deaths > 5
    for side in SIDES:
        uses = [use for use, _ in world.stores[side].uses().values() if use.startswith("guard ")]
        assert uses, "what has served is erased"
    world.close()


def kept(journal: ControllerJournal | PlantJournal) -> int:
    """The step of the record that a process would find."""
    record = journal.load().record
    assert record is not None
    return record.k


def put_back(guard: Defence, side: Side, steps: int, *, tampers: bool = False) -> KeyedEnds:
    """A world in which one end's journal was put back by some steps, within one session."""
    world = guarded_ends(guard)
    world.tampers = tampers
    world.well(300)
    end, journal = world.ends[side].endpoint, world.journals[side]
    world.run(lambda: kept(journal) >= end.record.k - 1)
    step, rows = kept(journal), contents(journal)
    world.run(lambda: end.record.k >= step + steps)
    fill(journal, rows)
    # whose journal was put back says copy 0 of its steps once more, and counts them otherwise
    world.copies, world.counted = Copies(), {s: {} for s in SIDES}
    world.die(side)
    world.well(200)
    return world


@pytest.mark.parametrize("steps", size([1, 8], [1, 2, 8]))
@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("made", GUARDS)
def test_a_journal_that_was_put_back_puts_no_two_messages_under_one_word(
    made: Callable[[int, int], Defence], side: Side, steps: int
) -> None:
    world = put_back(made(1, 2), side, steps)
    before = len(world.slots.served)
    world.well(60)
    assert len(world.slots.served) > before, "nothing is guarded any more"
    world.close()


@pytest.mark.wrong_on_purpose
@pytest.mark.parametrize("made", GUARDS)
def test_a_batch_of_an_earlier_process_would_put_two_messages_under_one_word(
    made: Callable[[int, int], Defence],
) -> None:
    with pytest.MonkeyPatch.context() as patch, pytest.raises(AssertionError, match="two messages"):
        every_process_goes_on_with_the_batch(patch)
        put_back(made(1, 2), "plant", 1, tampers=True)


def every_process_goes_on_with_the_batch(patch: pytest.MonkeyPatch) -> None:
    """A batch serves the next process too, from its first slot on."""
    broken(patch, guards, "if _instance(use) == task.instance else -count", "if use else -count")


def a_slot_serves_two_steps(patch: pytest.MonkeyPatch) -> None:
    """A slot serves two steps."""
    right = Guard.closed

    def wrong(self: Guard, k: int, plain: bytes, after_k: int = -1) -> bytes:
        return right(self, k - k % 2, plain, after_k)

    patch.setattr(Guard, "closed", wrong)


def no_farewell(patch: pytest.MonkeyPatch) -> None:
    """A sender whose keys have run out sends bare messages."""
    right = Guard.closed

    def wrong(self: Guard, k: int, plain: bytes, after_k: int = -1) -> bytes:
        return plain if self.covers(k) < 0 else right(self, k, plain, after_k)

    patch.setattr(Guard, "closed", wrong)


WRONG_GUARDS = [every_process_goes_on_with_the_batch, a_slot_serves_two_steps, no_farewell]


@pytest.mark.wrong_on_purpose
@pytest.mark.parametrize("wrong", WRONG_GUARDS)
def test_a_wrong_one_is_caught(wrong: Callable[[pytest.MonkeyPatch], None]) -> None:
    with pytest.MonkeyPatch.context() as patch, pytest.raises(AssertionError):
        wrong(patch)
        for seed in range(6):
            shaken(guarded_ends(Mac(1, 2)), seed, 40).close()


# --- keys that are gone ---------------------------------------------------------------------------


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("made", GUARDS)
def test_a_loop_goes_on_when_an_end_has_lost_its_keys(
    made: Callable[[int, int], Defence], side: Side
) -> None:
    world = guarded_ends(made(1, 2))
    world.well(300)
    plant = world.journals["plant"].load().record
    assert isinstance(plant, ReceiverRecord)
    world.tampers = True  # a message under a lost key is refused, and told
    world.stores[side].close()
    world.stores[side] = KeyStore(None, side)
    world.die(side)
    world.well(200)
    later = world.journals["plant"].load().record
    assert isinstance(later, ReceiverRecord)
    assert later.applied_k > plant.k, "the loop stands still"
    before = len(world.slots.served)
    world.well(400)
    assert len(world.slots.served) > before, "nothing is guarded any more"
    world.close()


# --- one message ----------------------------------------------------------------------------------

PLAIN = (
    b'{"v":3,"session":"0000000000000000","k":%d,"x":[0.1,-2.3],"applied_k":%d,"x_after":[%s],'
    b'"copy_number":0,"nonce":"","applied_copy":0,"block":-1,"tag":""}'
)


def ends(defence: Defence, topic: str = "measurement") -> tuple[Guard, Guard]:
    """A sender and a hearer with one batch of 31 or 32 messages, from step 10 on."""
    key = Random(5).randbytes(4 * 32)
    sender, hearer = Guard(defence, topic), Guard(defence, topic)
    sender.add((Batch(3, key, 10),))
    hearer.add((Batch(3, key),))
    return sender, hearer


def measurement(k: int, applied_k: int, after: str) -> bytes:
    return PLAIN % (k, applied_k, after.encode())


@pytest.mark.parametrize("made", GUARDS)
@pytest.mark.parametrize("applied_k", [13, 12, 4])
def test_what_is_closed_opens_to_the_last_bit(
    made: Callable[[int, int], Defence], applied_k: int
) -> None:
    sender, hearer = ends(made(2, 4))
    plain = measurement(14, applied_k, "0.1,-2.3" if applied_k == 13 else "1e-17,123.456")
    wire = sender.closed(14, plain, applied_k + 1)
    Measurement.model_validate_json(wire)
    assert hearer.opened(14, wire, Promise()).plain == plain
    assert (b'"x":[0.1,-2.3]' in wire) == (made is Mac)


def test_a_step_that_no_batch_covers_leaves_with_a_farewell_or_plain() -> None:
    for made in GUARDS:
        sender, hearer = ends(made(2, 4))
        last = 39 if made is Mac else 40  # a point, and a word for the farewell
        assert sender.until(10) == last
        before = measurement(9, 3, "1.0,2.0")
        assert sender.closed(9, before, 4) == before
        after = measurement(last + 1, 3, "1.0,2.0")
        wire = sender.closed(last + 1, after, 4)
        assert (wire == after) == (made is Coding)
        assert hearer.opened(last + 1, wire, Promise(10, 3)).plain == after


def test_a_farewell_is_of_the_newest_batch_alone_and_is_not_to_be_forged() -> None:
    sender, hearer = ends(Mac(2, 4))
    plain = measurement(60, 3, "1.0,2.0")
    wire = sender.closed(60, plain, 4)
    opened = hearer.opened(60, wire, Promise(10, 3))
    assert (opened.plain, opened.number, opened.slot) == (plain, 3, -1)
    assert hearer.opened(60, wire, Promise(10, 4)).plain is None
    forged = wire[:-3] + (b"0" if wire[-3:-2] != b"0" else b"1") + wire[-2:]
    assert hearer.opened(60, forged, Promise(10, 3)).why
    used = sender.closed(39, measurement(39, 38, "0.1,-2.3"), 39)
    assert b'"guard":"3/29"' in used
    assert hearer.opened(60, used.replace(b"3/29", b"3/30"), Promise(10, 3)).why


def test_a_message_that_was_changed_in_one_byte_is_refused() -> None:
    sender, hearer = ends(Mac(2, 4))
    wire = sender.closed(14, measurement(14, 13, "0.1,-2.3"), 14)
    accepted = 0
    for at in range(len(wire)):
        changed = wire[:at] + bytes([wire[at] ^ 1]) + wire[at + 1 :]
        opened = hearer.opened(14, changed, Promise(10, 3))
        if opened.plain is not None:
            accepted += 1
            assert ANEW.sub(b"", opened.plain) == ANEW.sub(b"", measurement(14, 13, "0.1,-2.3"))
    assert accepted == 1, "the copy's number alone"


def test_a_copy_is_under_the_same_tag_and_another_direction_is_not() -> None:
    sender, _ = ends(Mac(2, 4))
    plain = measurement(14, 13, "0.1,-2.3")
    wire = sender.closed(14, plain, 14)
    copy = plain.replace(b'"copy_number":0,"nonce":""', b'"copy_number":1,"nonce":"xyz"')
    assert sender.closed(14, copy, 14)[-15:] == wire[-15:]
    _, offers = ends(Mac(2, 4), "offer")
    assert offers.opened(14, wire, Promise()).why


def test_once_a_message_was_tagged_none_is_taken_bare() -> None:
    _, hearer = ends(Mac(2, 4))
    plain = measurement(20, 3, "1.0,2.0")
    assert hearer.opened(20, plain, Promise()).plain == plain
    assert hearer.opened(20, plain, Promise(20, 3)).plain == plain
    assert hearer.opened(20, plain, Promise(10, 3)).why
    _, coded = ends(Coding(2, 4))
    assert coded.opened(20, plain, Promise(10, 3)).plain == plain


def test_a_batch_that_has_served_is_late_and_no_forgery() -> None:
    sender, hearer = ends(Mac(2, 4))
    wire = sender.closed(14, measurement(14, 13, "0.1,-2.3"), 14)
    hearer.add((Batch(4, bytes(128)),))
    hearer.drop_below(4)
    late = hearer.opened(14, wire, Promise(10, 4))
    assert (late.plain, late.lacking, late.why) == (None, -1, "")
    newer = wire.replace(b'"guard":"3/', b'"guard":"7/')
    assert hearer.opened(14, newer, Promise(10, 4)).lacking == 7
    assert hearer.without(14, newer, Promise(10, 4)).why
    assert hearer.without(14, newer, Promise()).plain == measurement(14, 13, "0.1,-2.3")


def test_a_message_that_needs_a_batch_that_has_served_is_late_and_no_forgery() -> None:
    """A repeat of measurement 41, which tells of step 40's state too, came after measurement 42."""
    sender, hearer = ends(Coding(2, 4))
    key = Random(6).randbytes(4 * 32)
    sender.add((Batch(4, key, 41),))
    hearer.add((Batch(4, key),))
    plain = measurement(41, 39, "1e-17,123.456")
    wire = sender.closed(41, plain, 40)
    assert b'"guard":"4/0","after":"3/30"' in wire
    opened = hearer.opened(41, wire, Promise())
    assert (opened.plain, opened.number, opened.needs) == (plain, 4, 3)
    hearer.drop_below(4)
    late = hearer.opened(41, wire, Promise())
    assert (late.plain, late.lacking, late.why) == (None, -1, "")
    never = wire.replace(b'"after":"3/30"', b'"after":"9/30"')
    assert hearer.opened(41, never, Promise()).why == "it does not open"
