"""Journals in memory, which mean what :mod:`runtime.journal`'s do: make-believe disks.

Like a file they outlive the end that writes them. Like a file they lose a record that was only
staged: an end that dies comes back with the record before the step, and the step.
"""

from typing import Generic

from protocol.agreement import NO_SYMBOL
from protocol.link.peer import Actions
from protocol.link.records import ReceiverRecord, SenderRecord
from protocol.messages import Measurement, Offer
from protocol.secret.nonces import Contribution
from runtime.journal import ReceiverJournal, SenderJournal
from runtime.journal_files import R


class _MemoryJournal(Generic[R]):
    """A record and the step that followed it."""

    def __init__(self) -> None:
        self.offer: Offer | None = None
        self.coin = NO_SYMBOL
        self.measurement: Measurement | None = None
        self._record: R | None = None
        self._staged: R | None = None
        self._contributions: dict[tuple[str, int], Contribution] = {}
        self._rows: list[Actions] = []

    def save(self, actions: Actions) -> None:
        """Keep what they save."""
        if actions.record is not None:
            self._staged = actions.record  # type: ignore[assignment]
            self._rows.append(actions)
            if actions.later:
                return
        assert self._staged is not None, "the step before has not been counted"
        self._record = self._staged
        self.offer, self.coin = actions.offer, actions.coin
        self.measurement = actions.measurement
        if actions.measurement is not None:
            self._staged = None
        self._write_rows()

    def _write_rows(self) -> None:
        for actions in self._rows:
            assert actions.record is not None
            session, contribution = actions.record.session, actions.contribution
            if contribution is not None and session is not None:
                self._contributions[session, contribution.j] = contribution
            over = {j for gone in actions.obsolete_rows for j in gone}
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
        self._record = self._staged = self.offer = self.measurement = None
        self.coin = NO_SYMBOL
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

    def save(self, actions: Actions) -> None:
        """Keep what they save."""
        super().save(actions)
        if actions.queued is not None:
            self._queue.append((actions.queued.id, actions.queued.payload))
            self.queued += 1

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

    def save(self, actions: Actions) -> None:
        """Keep what they save."""
        super().save(actions)
        self._chunks = actions.chunk if actions.drop_chunks else self._chunks + actions.chunk
        if actions.received is not None:
            self._inbox.append(actions.received)

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
