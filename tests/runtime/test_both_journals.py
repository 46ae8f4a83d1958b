"""What a journal means, asked of both: of the one in files after each death, and of its like."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from protocol.link.peer import Actions
from protocol.link.records import ReceiverRecord, SenderRecord
from protocol.messages import Measurement, Offer, SendCommand
from protocol.secret.nonces import Contribution
from runtime.journal import ControllerJournal, PlantJournal, ReceiverJournal, SenderJournal
from runtime.memory_journal import MemoryControllerJournal, MemoryPlantJournal

SCENARIO = "f" * 64
SESSION, NEXT = "0123456789abcdef", "fedcba9876543210"
SENDER = SenderRecord(session=SESSION, k=4, state=(0,))
RECEIVER = ReceiverRecord(session=SESSION, k=4, x=(0.5,), u=(0.0,))
OFFER = Offer(session=SESSION, k=4, candidates=((1.0,), (2.0,)), cipher=1)
MEASUREMENT = Measurement(session=SESSION, k=5, x=(0.1,), applied_k=4, x_after=(0.25,))

PlantAfterDeath = Callable[[], ReceiverJournal]
ControllerAfterDeath = Callable[[], SenderJournal]


def row(j: int) -> Contribution:
    return Contribution(j, 1, bytes([j]) * 32, None if j % 2 else bytes([j + 100]) * 32)


@pytest.fixture(params=["files", "memory"])
def plant(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[PlantAfterDeath]:
    """The plant's journal as the next process finds it."""
    in_memory = MemoryPlantJournal()
    with ExitStack() as opened:

        def after_death() -> ReceiverJournal:
            if request.param == "memory":
                return in_memory
            opened.close()
            return opened.enter_context(PlantJournal(tmp_path / "p", SCENARIO))

        yield after_death


@pytest.fixture(params=["files", "memory"])
def controller(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[ControllerAfterDeath]:
    """The controller's journal as the next process finds it."""
    in_memory = MemoryControllerJournal()
    with ExitStack() as opened:

        def after_death() -> SenderJournal:
            if request.param == "memory":
                return in_memory
            opened.close()
            return opened.enter_context(ControllerJournal(tmp_path / "c", SCENARIO))

        yield after_death


def test_a_new_journal_has_nothing(
    plant: PlantAfterDeath, controller: ControllerAfterDeath
) -> None:
    for journal in (plant(), controller()):
        assert (journal.load(), journal.contributions(SESSION)) == (None, [])
        assert (journal.offer, journal.measurement) == (None, None)
    assert (plant().chunks(), plant().inbox()) == ("", [])
    assert (controller().queued, controller().payload(0), controller().queued_as("a")) == (
        0,
        None,
        None,
    )


def test_a_step_comes_back_with_the_record_before_it_until_the_next_record(
    plant: PlantAfterDeath, controller: ControllerAfterDeath
) -> None:
    journal = plant()
    journal.save(Actions(record=RECEIVER))
    journal.save(Actions(offer=OFFER, coin=1, measurement=MEASUREMENT))
    queue = controller()
    queue.save(Actions(record=SENDER))
    queue.save(Actions(offer=OFFER, measurement=MEASUREMENT))
    journal = plant()
    assert journal.load() == RECEIVER
    assert (journal.offer, journal.coin, journal.measurement) == (OFFER, 1, MEASUREMENT)
    queue = controller()
    assert queue.load() == SENDER
    assert (queue.offer, queue.measurement) == (OFFER, MEASUREMENT)
    journal.save(Actions(record=RECEIVER._replace(k=5)))
    journal = plant()
    assert journal.load() == RECEIVER._replace(k=5)
    assert (journal.offer, journal.measurement) == (None, None)


def test_a_staged_record_and_its_row_are_lost_with_the_process(plant: PlantAfterDeath) -> None:
    plant().save(Actions(record=RECEIVER, contribution=row(3)))
    plant().save(Actions(record=RECEIVER._replace(k=5), later=True, contribution=row(4)))
    journal = plant()
    assert journal.load() == RECEIVER
    assert journal.contributions(SESSION) == [row(3)]
    journal.save(Actions(record=RECEIVER._replace(k=5), later=True, contribution=row(4)))
    journal.save(Actions(offer=OFFER, coin=0, measurement=MEASUREMENT))
    assert plant().load() == RECEIVER._replace(k=5)
    assert plant().contributions(SESSION) == [row(3), row(4)]


def test_a_step_is_begun_and_then_read(plant: PlantAfterDeath) -> None:
    journal = plant()
    journal.save(Actions(record=RECEIVER))
    journal.save(Actions(offer=OFFER, coin=1))
    journal = plant()
    assert journal.load() == RECEIVER
    assert (journal.offer, journal.coin, journal.measurement) == (OFFER, 1, None)
    for session in (SESSION, NEXT):  # a record that comes while it is under way; the rare one too
        journal.save(Actions(record=RECEIVER._replace(session=session), offer=OFFER, coin=1))
        journal = plant()
        assert journal.load() == RECEIVER._replace(session=session)
        assert (journal.offer, journal.coin, journal.measurement) == (OFFER, 1, None)
    journal.save(Actions(offer=OFFER, coin=1, measurement=MEASUREMENT))
    journal = plant()
    assert journal.load() == RECEIVER._replace(session=NEXT)
    assert (journal.offer, journal.coin, journal.measurement) == (OFFER, 1, MEASUREMENT)


def test_a_record_takes_the_place_of_a_step_that_was_begun(plant: PlantAfterDeath) -> None:
    """Another process would take it for its own, and count it as interrupted once more."""
    for session in (SESSION, SESSION, NEXT):  # in a rare write, among the steps, in a rare one
        record = RECEIVER._replace(session=session)
        plant().save(Actions(record=record, offer=OFFER, coin=1))
        journal = plant()
        assert journal.load() == record
        assert journal.offer == OFFER
        journal.save(Actions(record=record))
        journal = plant()
        assert journal.load() == record
        assert (journal.offer, journal.measurement) == (None, None)


def test_rows_go_when_they_are_obsolete_and_with_their_session(plant: PlantAfterDeath) -> None:
    for j in range(5):
        plant().save(Actions(record=RECEIVER, contribution=row(j)))
    plant().save(Actions(record=RECEIVER, obsolete_rows=(range(2), range(3, 4))))
    assert plant().contributions(SESSION) == [row(2), row(4)]
    plant().save(Actions(record=RECEIVER._replace(session=NEXT), contribution=row(0)))
    assert plant().contributions(SESSION) == []
    assert plant().contributions(NEXT) == [row(0)]


def test_symbols_and_messages_come_with_the_record(plant: PlantAfterDeath) -> None:
    plant().save(Actions(record=RECEIVER, chunk="100"))
    plant().save(Actions(record=RECEIVER, chunk="11"))
    assert plant().chunks() == "10011"
    plant().save(Actions(record=RECEIVER, chunk="1", drop_chunks=True, received=b"whole"))
    plant().save(Actions(record=RECEIVER, received=b"second"))
    assert plant().chunks() == "1"
    assert plant().inbox() == [b"whole", b"second"]
    assert plant().inbox(1) == [b"second"]


def test_messages_are_numbered_in_order(controller: ControllerAfterDeath) -> None:
    controller().save(Actions(record=SENDER, queued=SendCommand(id="a", payload=b"first")))
    controller().save(Actions(record=SENDER, queued=SendCommand(id="b", payload=b"second")))
    journal = controller()
    assert journal.queued == 2
    assert [journal.payload(number) for number in range(3)] == [b"first", b"second", None]
    assert journal.identifier(1) == "b"
    assert (journal.queued_as("b"), journal.queued_as("c")) == (b"second", None)
