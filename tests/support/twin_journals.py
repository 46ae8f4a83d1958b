"""Journals in memory with a twin on disk, which must say the same after every death.

A death is a copy of the twin's files as they lie there, half written if the test says so; the copy
is opened, and goes on.
"""

import shutil
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from protocol.agreement import NO_SYMBOL
from protocol.link.peer import Actions
from protocol.messages import Measurement, Offer, SendCommand
from protocol.secret.nonces import Contribution
from runtime.journal import ControllerJournal, PlantJournal
from runtime.memory_journal import MemoryControllerJournal, MemoryPlantJournal

SCENARIO = "f" * 64

ALL = 10**6
"""Messages of an inbox: more than any test receives."""

T = TypeVar("T", ControllerJournal, PlantJournal)


def copied(journal: Path, folder: Path) -> Path:
    """A copy of a journal's files, as a death leaves them."""
    folder.mkdir()
    for path in journal.parent.glob(f"{journal.name}*"):
        shutil.copyfile(path, folder / path.name)
    return folder / journal.name


NO_STEP = (None, NO_SYMBOL, None)


def step_of(
    journal: ControllerJournal | PlantJournal | MemoryControllerJournal | MemoryPlantJournal,
) -> tuple[Offer | None, int, Measurement | None]:
    """The step that followed the record; :data:`NO_STEP` where none did."""
    return journal.offer, journal.coin, journal.measurement


def queue_of(journal: ControllerJournal | MemoryControllerJournal) -> list[tuple[str, bytes]]:
    """The controller's messages, each after its identifier."""
    queue = []
    for number in range(journal.queued):
        payload = journal.payload(number)
        assert payload is not None
        queue.append((journal.identifier(number), payload))
    return queue


class _Twin(Generic[T]):
    """What both kinds share; comes before the journal in memory among the bases."""

    kind: type[T]

    if TYPE_CHECKING:
        offer: Offer | None
        coin: int
        measurement: Measurement | None

    def __init__(self, *payloads: bytes) -> None:
        super().__init__(*payloads)
        self.folder = Path(tempfile.mkdtemp())
        self.lives = 0
        self.twin: T = self._new()

    def _new(self) -> T:
        self.lives += 1
        twin = self.kind(self.folder / f"{self.lives}" / "journal", SCENARIO)
        if isinstance(twin, ControllerJournal):
            assert isinstance(self, MemoryControllerJournal)
            for identifier, payload in queue_of(self):
                twin.enqueue(SendCommand(id=identifier, payload=payload))
        return twin

    def save(self, actions: Actions) -> None:
        """Keep it in both."""
        super().save(actions)  # type: ignore[misc]
        self.twin.save(actions)

    def load(self) -> Any:
        """The record as last written: the process has died, and another one opens its files."""
        self.lives += 1
        path = copied(self.twin.path, self.folder / f"{self.lives}")
        self.twin.close()
        self.twin = self.kind(path, SCENARIO)
        record = super().load()  # type: ignore[misc]
        assert self.twin.load() == record
        assert step_of(self.twin) == (self.offer, self.coin, self.measurement)
        return record

    def contributions(self, session: str | None) -> list[Contribution]:
        """The rows of both."""
        rows: list[Contribution] = super().contributions(session)  # type: ignore[misc]
        assert self.twin.contributions(session) == rows
        return rows

    def forget(self) -> None:
        """Lose both."""
        super().forget()  # type: ignore[misc]
        self.twin.close()
        self.twin = self._new()

    def close(self) -> None:
        """Remove the files."""
        self.twin.close()
        shutil.rmtree(self.folder)


class TwinControllerJournal(_Twin[ControllerJournal], MemoryControllerJournal):
    """The controller's."""

    kind = ControllerJournal

    def load(self) -> Any:
        """The record, and the queue beside it."""
        record = super().load()
        assert queue_of(self.twin) == queue_of(self)
        return record


class TwinPlantJournal(_Twin[PlantJournal], MemoryPlantJournal):
    """The plant's."""

    kind = PlantJournal

    def load(self) -> Any:
        """The record, and what came with it."""
        record = super().load()
        assert self.twin.chunks() == self.chunks()
        assert self.twin.inbox(ALL) == self.inbox(ALL)
        return record
