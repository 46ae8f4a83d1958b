"""Journals: what each end must not forget, saved before anything is sent.

:class:`SenderJournal` and :class:`ReceiverJournal` say what a journal does, wherever it lies. There
are two of each: in files, here and in :mod:`runtime.journal_files`, and in memory
(:mod:`runtime.memory_journal`).
"""

from pathlib import Path
from typing import Any, Protocol

from pydantic import TypeAdapter

from protocol.link.peer import Save
from protocol.link.records import ReceiverRecord, SenderRecord, Step
from protocol.secret.nonces import Contribution
from runtime.journal_files import JournalError, JournalFiles
from runtime.keys.store_file import check_of
from runtime.ports import Journal


class SenderJournal(Journal, Protocol):
    """The controller's journal, with the queue of messages that it has to deliver.

    ``queued`` counts them; they are numbered from 0.
    """

    queued: int

    def load(self) -> SenderRecord | None:
        """The record as last written; None in a new journal."""

    def step(self) -> Step | None:
        """The step that followed the record, to be counted again; None where none did."""

    def contributions(self, session: str | None) -> list[Contribution]:
        """Rows of the session's key blocks that are still needed, in order."""

    def payload(self, number: int) -> bytes | None:
        """Message ``number``, or None while it is not queued."""

    def identifier(self, number: int) -> str:
        """Identifier of the queued message ``number``."""

    def queued_as(self, identifier: str) -> bytes | None:
        """The message that was ever queued under this identifier, or None."""


class ReceiverJournal(Journal, Protocol):
    """The plant's journal, with the symbols of the frame under way and the messages received."""

    def load(self) -> ReceiverRecord | None:
        """The record as last written; None in a new journal."""

    def step(self) -> Step | None:
        """The step after the record, or the one that the record says was begun; None: none."""

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

    def step(self) -> Step | None:
        """The step that followed the record, to be counted again; None where none did.

        Raises
        ------
        JournalError
            When it is not one.
        """
        return self._step()

    def _add_to_tables(self, save: Save) -> None:
        if save.queued is not None:
            self.enqueue(*save.queued)

    def enqueue(self, identifier: str, payload: bytes) -> bool:
        """Queue a message; False when one of this identifier is there already."""
        row = (self.queued, identifier, payload)
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

    def step(self) -> Step | None:
        """The step after the record, or the one that the record says was begun; None: none.

        Raises
        ------
        JournalError
            When it is not one.
        """
        step = self._step()
        if step is not None or self._found is None:
            return step
        with self._readable():
            record: ReceiverRecord = self.adapter.validate_json(self._found.record)
        return record.begun

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

    def _add_to_tables(self, save: Save) -> None:
        if save.drop_chunks:
            self._execute("DELETE FROM chunk")
        if save.chunk:
            row = (save.chunk, check_of(save.chunk))
            self._execute("INSERT INTO chunk (symbols, check_) VALUES (?, ?)", row)
        if save.received is not None:
            message = (save.received, check_of(save.received))
            self._execute("INSERT INTO inbox (payload, check_) VALUES (?, ?)", message)
