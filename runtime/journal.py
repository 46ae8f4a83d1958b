"""Journals: what each end must not forget, saved before anything is sent.

:class:`SenderJournal` and :class:`ReceiverJournal` say what a journal does, wherever it lies. There
are two of each: in files, here and in :mod:`runtime.journal_files`, and in memory
(:mod:`runtime.memory_journal`).
"""

from pathlib import Path
from typing import Any, Protocol

from pydantic import TypeAdapter

from protocol.link.peer import Actions
from protocol.link.records import ReceiverRecord, SenderRecord
from protocol.messages import Measurement, Offer, SendCommand
from protocol.secret.nonces import Contribution
from runtime.journal_files import JournalError, JournalFiles
from runtime.keys.store_file import check_of
from runtime.ports import Journal


class SenderJournal(Journal, Protocol):
    """The controller's journal, with the queue of messages that it has to deliver.

    ``queued`` counts them; they are numbered from 0. ``offer`` and the ``measurement`` that it
    answers are the step that followed the record, to be counted again; None where none did.
    """

    queued: int
    offer: Offer | None
    measurement: Measurement | None

    def load(self) -> SenderRecord | None:
        """The record as last written, and what followed it; None in a new journal."""

    def contributions(self, session: str | None) -> list[Contribution]:
        """Rows of the session's key blocks that are still needed, in order."""

    def payload(self, number: int) -> bytes | None:
        """Message ``number``, or None while it is not queued."""

    def identifier(self, number: int) -> str:
        """Identifier of the queued message ``number``."""

    def queued_as(self, identifier: str) -> bytes | None:
        """The message that was ever queued under this identifier, or None."""


class ReceiverJournal(Journal, Protocol):
    """The plant's journal, with the symbols of the frame under way and the messages received.

    ``offer``, ``coin`` and ``measurement`` are the step that followed the record, to be counted
    again, or, with no measurement, one that was begun and not read; no offer: none.
    """

    offer: Offer | None
    coin: int
    measurement: Measurement | None

    def load(self) -> ReceiverRecord | None:
        """The record as last written, and what followed it; None in a new journal."""

    def contributions(self, session: str | None) -> list[Contribution]:
        """Rows of the session's key blocks that are still needed, in order."""

    def chunks(self) -> str:
        """Symbols of the frame under way that have left the record, a hexadecimal digit each."""

    def inbox(self, last: int = 100) -> list[bytes]:
        """The last messages received, oldest first."""


class ControllerJournal(JournalFiles[SenderRecord], SenderJournal):
    """The controller's, in files."""

    kind = "controller"
    adapter = TypeAdapter(SenderRecord)
    tables = (
        "CREATE TABLE IF NOT EXISTS outbox "
        "(number INTEGER PRIMARY KEY, id TEXT UNIQUE NOT NULL, payload BLOB NOT NULL, "
        "check_ INTEGER)"
    )

    def __init__(self, path: Path, scenario: str) -> None:
        super().__init__(path, scenario)
        self.queued: int = self._execute("SELECT COUNT(*) FROM outbox")[0][0]

    def _add_to_tables(self, actions: Actions) -> None:
        if actions.queued is not None:
            self.enqueue(actions.queued)

    def enqueue(self, command: SendCommand) -> bool:
        """Queue a message; False when one of this identifier is there already."""
        row = (self.queued, command.id, command.payload)
        added = self._execute(
            "INSERT OR IGNORE INTO outbox VALUES (?, ?, ?, ?) RETURNING number",
            (*row, check_of(*row)),
        )
        self.queued += len(added)
        return bool(added)

    def _queued(self, name: str, value: object) -> list[Any]:
        """Number, identifier and payload of the messages whose column ``name`` is so."""
        return self._rows_kept(f"SELECT * FROM outbox WHERE {name} = ?", (value,))

    def _numbered(self, number: int) -> list[Any]:
        rows = self._queued("number", number)
        if not rows:
            raise JournalError(f"{self.path}: message {number} is missing")
        found: list[Any] = rows[0]
        return found

    def queued_as(self, identifier: str) -> bytes | None:
        """The message that was ever queued under this identifier, or None."""
        rows = self._queued("id", identifier)
        return rows[0][2] if rows else None

    def payload(self, number: int) -> bytes | None:
        """Message ``number``, or None while it is not queued."""
        if number >= self.queued:
            return None
        payload: bytes = self._numbered(number)[2]
        return payload

    def identifier(self, number: int) -> str:
        """Identifier of the queued message ``number``."""
        identifier: str = self._numbered(number)[1]
        return identifier


class PlantJournal(JournalFiles[ReceiverRecord], ReceiverJournal):
    """The plant's, in files."""

    kind = "plant"
    adapter = TypeAdapter(ReceiverRecord)
    tables = (
        "CREATE TABLE IF NOT EXISTS chunk (place INTEGER PRIMARY KEY, symbols TEXT NOT NULL, "
        "check_ INTEGER);"
        "CREATE TABLE IF NOT EXISTS inbox (number INTEGER PRIMARY KEY, payload BLOB NOT NULL, "
        "check_ INTEGER)"
    )

    def chunks(self) -> str:
        """Symbols of the frame under way that have left the record, a hexadecimal digit each."""
        rows = self._rows_kept("SELECT symbols, check_ FROM chunk ORDER BY place")
        return "".join(symbols for (symbols,) in rows)

    def inbox(self, last: int = 100) -> list[bytes]:
        """The last messages received, oldest first."""
        rows = self._rows_kept(
            "SELECT payload, check_ FROM inbox ORDER BY number DESC LIMIT ?", (last,)
        )
        return [payload for (payload,) in reversed(rows)]

    def _add_to_tables(self, actions: Actions) -> None:
        if actions.drop_chunks:
            self._execute("DELETE FROM chunk")
        if actions.chunk:
            row = (actions.chunk, check_of(actions.chunk))
            self._execute("INSERT INTO chunk (symbols, check_) VALUES (?, ?)", row)
        if actions.received is not None:
            message = (actions.received, check_of(actions.received))
            self._execute("INSERT INTO inbox (payload, check_) VALUES (?, ?)", message)
