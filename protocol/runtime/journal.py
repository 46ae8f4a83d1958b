"""Journals: what each end must not forget, in SQLite, saved before anything is sent.

What a step hangs on is kept as it passed: the record that stood before it, the message heard and
the message about to be said. That is all it takes to count the step again, so a side may send
first and count afterwards, while its partner works. The next save brings the record up to date.

Write-ahead logging makes a save cost some ten microseconds and survive ``kill -9`` of the process
at any instant. After a power failure the last saves may be missing; the two journals then do not
fit together and the session ends, as rule 6 says. A journal is held by one process at a time.
"""

import os
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar, Final, NamedTuple, Self, TypeVar

from pydantic import BaseModel, TypeAdapter, ValidationError

from protocol.agreement import NO_SYMBOL
from protocol.link.endpoint import Append, Keep, Write
from protocol.link.receiver import ReceiverRecord
from protocol.link.sender import SenderRecord
from protocol.messages import Measurement, Offer
from protocol.runtime.process import Failure
from protocol.runtime.run_folder import make_folder, open_private
from protocol.secret.nonces import Raw

JOURNAL_VERSION: Final = 6

_M = TypeVar("_M", bound=BaseModel)
_N = TypeVar("_N", bound=BaseModel)

_RAW: Final = (
    "CREATE TABLE IF NOT EXISTS raw (session TEXT, j INTEGER, steps INTEGER, offer BLOB, "
    "measurement BLOB, PRIMARY KEY (session, j)) WITHOUT ROWID"
)
"""Rows of key blocks under way; they cannot be in the record, which is rewritten at each step."""

_SAVE: Final = "INSERT OR REPLACE INTO record VALUES (0, ?, ?, ?, ?)"


class JournalError(Failure):
    """A journal that cannot be used; the text names the file and what is wrong with it."""


class SenderStep(NamedTuple):
    """What the controller heard and said after its record was made."""

    measurement: Measurement
    offer: Offer


class ReceiverStep(NamedTuple):
    """What the plant heard and said after its record was made; ``coin`` is the b_r between."""

    offer: Offer
    measurement: Measurement
    coin: int


class BegunStep(NamedTuple):
    """A step that the plant had begun when it died: the offer, and the candidate it had chosen."""

    offer: Offer
    coin: int


class _Journal:
    """A SQLite file with one record and the step that followed it, held exclusively."""

    kind = ""
    tables = ""
    adapter: ClassVar[TypeAdapter[Any]]

    def __init__(self, path: Path, scenario: str) -> None:
        self.path = path
        self._body: bytes | None = None
        self._rows: list[Keep] = []
        self._rows_of: str | None = None
        self._forget = True
        try:
            make_folder(path.parent)
            os.close(open_private(path, os.O_RDWR | os.O_CREAT))  # SQLite gives the others its mode
            self._db = sqlite3.connect(
                path, isolation_level=None, timeout=2.0, check_same_thread=False
            )
        except (OSError, sqlite3.Error) as error:
            raise JournalError(f"{path}: cannot be opened: {error}") from None
        try:
            self._open(scenario)
        except sqlite3.Error as error:
            self._db.close()
            reason = (
                "another process is using it"
                if "locked" in str(error)
                else f"not a journal: {error}"
            )
            raise JournalError(f"{path}: {reason}") from None
        except JournalError:
            self._db.close()
            raise

    def _open(self, scenario: str) -> None:
        db = self._db
        # A save rewrites one page and a checkpoint flushes them all: small pages cost less of both.
        db.execute("PRAGMA page_size=1024")
        db.execute("PRAGMA locking_mode=EXCLUSIVE")
        db.execute("PRAGMA journal_mode=WAL")
        db.execute("PRAGMA synchronous=NORMAL")
        db.execute("PRAGMA secure_delete=ON")
        db.execute("BEGIN IMMEDIATE")
        db.execute("CREATE TABLE IF NOT EXISTS meta (name TEXT PRIMARY KEY, value TEXT)")
        db.execute(
            "CREATE TABLE IF NOT EXISTS record "
            "(id INTEGER PRIMARY KEY, body BLOB, heard BLOB, said BLOB, coin INTEGER)"
        )
        for table in (_RAW, *self.tables.split(";")):
            db.execute(table)
        expected = {"kind": self.kind, "version": str(JOURNAL_VERSION), "scenario": scenario}
        for name, value in expected.items():
            row = db.execute("SELECT value FROM meta WHERE name = ?", (name,)).fetchone()
            if row is None:
                db.execute("INSERT INTO meta VALUES (?, ?)", (name, value))
            elif row[0] != value:
                db.execute("ROLLBACK")
                raise JournalError(f"{self.path}: {name}: got {row[0]!r}, expected {value!r}")
        db.execute("COMMIT")

    def _execute(self, statement: str, values: Sequence[Any] = ()) -> sqlite3.Cursor:
        try:
            return self._db.execute(statement, values)
        except sqlite3.Error as error:
            raise JournalError(f"{self.path}: {error}") from None

    def _load(self) -> Any:
        row = self._execute("SELECT body FROM record WHERE id = 0").fetchone()
        if row is None:
            return None
        self._body = bytes(row[0])
        with self._readable():
            return self.adapter.validate_json(row[0])

    def _step(self, heard: type[_M], said: type[_N]) -> tuple[_M, _N, int] | None:
        row = self._execute("SELECT heard, said, coin FROM record WHERE id = 0").fetchone()
        if row is None or row[0] is None or row[1] is None:
            return None
        with self._readable():
            return heard.model_validate_json(row[0]), said.model_validate_json(row[1]), row[2]

    @contextmanager
    def _readable(self) -> Iterator[None]:
        try:
            yield
        except ValidationError as error:
            raise JournalError(
                f"{self.path}: record: {error.error_count()} fields are not as expected"
            ) from None

    def raws(self, session: str | None) -> list[Raw]:
        """Rows of the session's key blocks that are not settled, in order."""
        self._rows_of = session
        rows = self._execute(
            "SELECT j, steps, offer, measurement FROM raw WHERE session = ? ORDER BY j", (session,)
        )
        return [Raw(*row) for row in rows]

    def _stage_rows(self, keep: Keep) -> None:
        """What ``keep`` means for the rows goes with the next write."""
        session = keep.record.session
        if session != self._rows_of:
            self._rows.append(keep)
            self._rows_of, self._forget = session, True
        elif keep.raw is not None or keep.settled:
            self._rows.append(keep)

    def _write_rows(self) -> None:
        """Within a transaction."""
        if self._forget:
            self._execute("DELETE FROM raw WHERE session IS NOT ?", (self._rows_of,))
            self._forget = False
        for keep in self._rows:
            session = keep.record.session
            if session != self._rows_of:
                continue
            if keep.raw is not None:
                self._execute(
                    "INSERT OR REPLACE INTO raw VALUES (?, ?, ?, ?, ?)", (session, *keep.raw)
                )
            for over in keep.settled:
                self._execute(
                    "DELETE FROM raw WHERE session = ? AND j >= ? AND j < ?",
                    (session, over.start, over.stop),
                )
        self._rows.clear()

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        self._execute("BEGIN IMMEDIATE")
        yield
        self._write_rows()
        self._execute("COMMIT")

    def _stage(self, record: Any) -> bytes:
        self._body = body = self.adapter.dump_json(record)
        return body

    def _append(self, heard: bytes, said: bytes, coin: int) -> None:
        assert self._body is not None, "the step before has not been counted"
        row = (self._body, heard, said or None, coin)
        if self._rows:
            with self._transaction():
                self._execute(_SAVE, row)
        else:
            self._execute(_SAVE, row)
        if said:
            self._body = None

    def close(self) -> None:
        """Close the file; it can be opened again."""
        self._db.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class ControllerJournal(_Journal):
    """The controller's record and the messages it has to deliver."""

    kind = "controller"
    adapter = TypeAdapter(SenderRecord)
    tables = (
        "CREATE TABLE IF NOT EXISTS outbox "
        "(number INTEGER PRIMARY KEY, id TEXT UNIQUE NOT NULL, payload BLOB NOT NULL)"
    )

    def __init__(self, path: Path, scenario: str) -> None:
        super().__init__(path, scenario)
        row = self._execute("SELECT COUNT(*) FROM outbox").fetchone()
        self.queued: int = row[0]

    def load(self) -> SenderRecord | None:
        """The record as last saved, or None in a new journal.

        Raises
        ------
        JournalError
            When it is not one.
        """
        record: SenderRecord | None = self._load()
        return record

    def step(self) -> SenderStep | None:
        """The step that followed the record, to be counted again; None where none did.

        Raises
        ------
        JournalError
            When it is not one.
        """
        found = self._step(Measurement, Offer)
        return None if found is None else SenderStep(*found[:2])

    def write(self, write: Write) -> None:
        """Keep what the endpoint asks for; only a ``later`` record waits for the next step."""
        if isinstance(write, Append):
            self._append(write.heard, write.said, write.coin)
            return
        self._stage_rows(write)
        if write.later:
            self._stage(write.record)
            return
        with self._transaction():
            self._execute(_SAVE, (self._stage(write.record), None, None, None))
            if write.queued is not None:
                self.enqueue(*write.queued)

    def save(self, record: SenderRecord) -> None:
        """Keep ``record``; on return it survives the death of this process."""
        self._execute(_SAVE, (self._stage(record), None, None, None))

    def stage(self, record: SenderRecord) -> None:
        """``record`` is what :meth:`append` will build on; nothing is written yet."""
        self._stage(record)

    def append(self, measurement: bytes, offer: bytes) -> None:
        """Keep the last record, the measurement that followed it, and the offer in answer.

        On return it survives the death of this process. The record is the one that was last
        loaded, saved or staged; the next one must be staged or saved before the next step.
        """
        self._append(measurement, offer, NO_SYMBOL)

    def enqueue(self, identifier: str, payload: bytes) -> bool:
        """Queue a message; False when one of this identifier is there already."""
        cursor = self._execute(
            "INSERT OR IGNORE INTO outbox VALUES (?, ?, ?)", (self.queued, identifier, payload)
        )
        added = cursor.rowcount == 1
        self.queued += added
        return added

    def queued_as(self, identifier: str) -> bytes | None:
        """The message that was ever queued under this identifier, or None."""
        row = self._execute("SELECT payload FROM outbox WHERE id = ?", (identifier,)).fetchone()
        return None if row is None else bytes(row[0])

    def payload(self, number: int) -> bytes | None:
        """Message ``number``, or None while it is not queued."""
        if number >= self.queued:
            return None
        row = self._execute("SELECT payload FROM outbox WHERE number = ?", (number,)).fetchone()
        return bytes(row[0])

    def identifier(self, number: int) -> str:
        """Identifier of the queued message ``number``."""
        row = self._execute("SELECT id FROM outbox WHERE number = ?", (number,)).fetchone()
        return str(row[0])


class PlantJournal(_Journal):
    """The plant's record, the symbols of the frame under way, and the messages received."""

    kind = "plant"
    adapter = TypeAdapter(ReceiverRecord)
    tables = (
        "CREATE TABLE IF NOT EXISTS chunk (place INTEGER PRIMARY KEY, symbols TEXT NOT NULL);"
        "CREATE TABLE IF NOT EXISTS inbox (number INTEGER PRIMARY KEY, payload BLOB NOT NULL)"
    )

    def load(self) -> ReceiverRecord | None:
        """The record as last saved, or None in a new journal.

        Raises
        ------
        JournalError
            When it is not one.
        """
        record: ReceiverRecord | None = self._load()
        return record

    def step(self) -> ReceiverStep | None:
        """The step that followed the record, to be counted again; None where none did.

        Raises
        ------
        JournalError
            When it is not one.
        """
        found = self._step(Offer, Measurement)
        return None if found is None else ReceiverStep(*found)

    def begun(self) -> BegunStep | None:
        """The step that was begun after the record and not read, if any.

        Raises
        ------
        JournalError
            When it is not one.
        """
        row = self._execute("SELECT heard, said, coin FROM record WHERE id = 0").fetchone()
        if row is None or row[0] is None or row[1] is not None:
            return None
        with self._readable():
            return BegunStep(Offer.model_validate_json(row[0]), row[2])

    def chunks(self) -> str:
        """Symbols of the frame under way that have left the record, a hexadecimal digit each."""
        rows = self._execute("SELECT symbols FROM chunk ORDER BY place")
        return "".join(symbols for (symbols,) in rows)

    def inbox(self, last: int = 100) -> list[bytes]:
        """The last messages received, oldest first."""
        rows = self._execute(
            "SELECT payload FROM inbox ORDER BY number DESC LIMIT ?", (last,)
        ).fetchall()
        return [bytes(payload) for (payload,) in reversed(rows)]

    def write(self, write: Write) -> None:
        """Keep what the endpoint asks for; only a ``later`` record waits for the next step."""
        if isinstance(write, Append):
            self._append(write.heard, write.said, write.coin)
            return
        self._stage_rows(write)
        if write.later:
            self._stage(write.record)
            return
        assert isinstance(write.record, ReceiverRecord)
        self.save(
            write.record,
            chunk=write.chunk,
            drop_chunks=write.drop_chunks,
            received=write.received,
        )

    def save(
        self,
        record: ReceiverRecord,
        *,
        chunk: str = "",
        drop_chunks: bool = False,
        received: bytes | None = None,
    ) -> None:
        """Keep ``record`` and what came with it, all or nothing.

        Parameters
        ----------
        record : ReceiverRecord
        chunk : str
            Symbols of the frame under way that have left the record.
        drop_chunks : bool
            The frame under way ended or was given up.
        received : bytes, optional
            The payload of a whole frame.
        """
        row = (self._stage(record), None, None, None)
        if not (chunk or drop_chunks or self._rows) and received is None:
            self._execute(_SAVE, row)
            return
        with self._transaction():
            self._execute(_SAVE, row)
            if drop_chunks:
                self._execute("DELETE FROM chunk")
            if chunk:
                self._execute("INSERT INTO chunk (symbols) VALUES (?)", (chunk,))
            if received is not None:
                self._execute("INSERT INTO inbox (payload) VALUES (?)", (received,))

    def stage(self, record: ReceiverRecord) -> None:
        """``record`` is what :meth:`append` will build on; nothing is written yet."""
        self._stage(record)

    def append(self, offer: bytes, measurement: bytes, coin: int) -> None:
        """Keep the last record, the offer applied by ``coin``, and the measurement of where it led.

        On return it survives the death of this process. The record is the one that was last
        loaded, saved or staged; the next one must be staged or saved before the next step.
        """
        self._append(offer, measurement, coin)
