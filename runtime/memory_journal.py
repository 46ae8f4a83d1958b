"""Journals in memory, which mean what :mod:`runtime.journal`'s do: make-believe disks.

Like a file they outlive the end that writes them. Like a file they lose a record that was only
staged: an end that dies comes back with the record before the step, and the step.
"""

from typing import Generic

from protocol.link.peer import Save, Write
from protocol.link.records import ReceiverRecord, SenderRecord, Step
from protocol.secret.nonces import Contribution
from runtime.journal import ReceiverJournal, SenderJournal
from runtime.journal_files import R


class _MemoryJournal(Generic[R]):
    """A record and the step that followed it."""

    def __init__(self) -> None:
        self._record: R | None = None
        self._staged: R | None = None
        self._step: Step | None = None
        self._contributions: dict[tuple[str, int], Contribution] = {}
        self._rows: list[Save] = []

    def write(self, write: Write) -> None:
        """Keep what the endpoint asks for."""
        if isinstance(write, Step):
            assert self._staged is not None, "the step before has not been counted"
            self._record, self._step = self._staged, write
            if write.measurement is not None:
                self._staged = None
            self._write_rows()
            return
        self._staged = write.record  # type: ignore[assignment]
        self._rows.append(write)
        if not write.later:
            self._record, self._step = self._staged, None
            self._write_rows()

    def _write_rows(self) -> None:
        for save in self._rows:
            session = save.record.session
            if save.contribution is not None and session is not None:
                self._contributions[session, save.contribution.j] = save.contribution
            over = {j for gone in save.obsolete_rows for j in gone}
            for at in [at for at in self._contributions if at[0] != session or at[1] in over]:
                del self._contributions[at]
        self._rows.clear()

    def contributions(self, session: str | None) -> list[Contribution]:
        """Rows of the session's key blocks that are still needed, in order."""
        return [
            contribution
            for (whose, _), contribution in sorted(self._contributions.items())
            if whose == session
        ]

    def load(self) -> R | None:
        """The record as last written, as after a restart; None in a new journal."""
        self._staged = self._record
        self._rows.clear()
        return self._record

    def forget(self) -> None:
        """Lose the record."""
        self._record = self._staged = self._step = None
        self._rows.clear()
        self._contributions.clear()

    def close(self) -> None:
        """Nothing is open."""


class MemoryControllerJournal(_MemoryJournal[SenderRecord], SenderJournal):
    """The controller's; :meth:`forget` leaves the queue of messages, which is the operator's.

    Parameters
    ----------
    payloads : sequence of bytes
        Messages queued already.
    """

    def __init__(self, *payloads: bytes) -> None:
        super().__init__()
        self._queue = [(f"{number}", payload) for number, payload in enumerate(payloads)]
        self.queued = len(payloads)

    def write(self, write: Write) -> None:
        """Keep what the endpoint asks for."""
        super().write(write)
        if isinstance(write, Save) and write.queued is not None:
            self._queue.append(write.queued)
            self.queued += 1

    def step(self) -> Step | None:
        """The step that followed the record, to be counted again; None where none did."""
        return self._step

    def payload(self, number: int) -> bytes | None:
        """Message ``number``, or None while it is not queued."""
        return self._queue[number][1] if number < len(self._queue) else None

    def identifier(self, number: int) -> str:
        """Identifier of the queued message ``number``."""
        return self._queue[number][0]

    def queued_as(self, identifier: str) -> bytes | None:
        """The message that was ever queued under this identifier, or None."""
        return dict(self._queue).get(identifier)


class MemoryPlantJournal(_MemoryJournal[ReceiverRecord], ReceiverJournal):
    """The plant's, with the symbols of the frame under way and the messages received."""

    def __init__(self) -> None:
        super().__init__()
        self._chunks = ""
        self._inbox: list[bytes] = []

    def write(self, write: Write) -> None:
        """Keep what the endpoint asks for."""
        super().write(write)
        if isinstance(write, Save):
            self._chunks = write.chunk if write.drop_chunks else self._chunks + write.chunk
            if write.received is not None:
                self._inbox.append(write.received)

    def step(self) -> Step | None:
        """The step after the record, or the one that the record says was begun; None: none."""
        if self._step is None and self._record is not None:
            return self._record.begun
        return self._step

    def chunks(self) -> str:
        """Symbols of the frame under way that have left the record, a hexadecimal digit each."""
        return self._chunks

    def inbox(self, last: int = 100) -> list[bytes]:
        """The last messages received, oldest first."""
        return self._inbox[-last:]

    def forget(self) -> None:
        """Lose everything."""
        super().forget()
        self._chunks, self._inbox = "", []
