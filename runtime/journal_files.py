"""The files of a journal: a database with what is rare, and beside it the steps since.

What a step hangs on is kept as it passed: the record that stood before it, the message heard and
the message about to be said. That is all it takes to count the step again, so a side may send
first and count afterwards, while its partner works. The next save brings the record up to date.

A step is one write to a file (:mod:`runtime.step_log`). What is rare goes to a database
(SQLite): messages, symbols that have left the record, obsolete rows, a new session. It has the
record too, as of then; the steps are what came after. Both survive ``kill -9`` of the process at
any instant. After a power failure the last saves may be missing; the two journals then do not fit
together and the session ends, as rule 6 says. Or one is refused in a line, where the disk has a
part of the zeros that took its steps' place. A journal is held by one process at a time.
"""

import os
import sqlite3
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar, Final, Generic, Self, TypeVar

from pydantic import TypeAdapter, ValidationError

from protocol.agreement import NO_SYMBOL
from protocol.link.peer import Actions
from protocol.link.records import ReceiverRecord, SenderRecord
from protocol.messages import Measurement, Offer
from protocol.secret.nonces import Contribution
from runtime.errors import Failure
from runtime.files import make_folder, open_private
from runtime.keys.store_file import check_of
from runtime.step_log import LARGEST_STEP, STEPS, TAG_BYTES, Damaged, Entry, StepLog

JOURNAL_VERSION: Final = 11

R = TypeVar("R", bound=SenderRecord | ReceiverRecord)

_RAW: Final = (
    "CREATE TABLE IF NOT EXISTS raw (session TEXT, j INTEGER, steps INTEGER, offer BLOB, "
    "measurement BLOB, check_ INTEGER, PRIMARY KEY (session, j)) WITHOUT ROWID"
)
"""Rows of key blocks under way; they cannot be in the record, which is rewritten at each step."""


class JournalError(Failure):
    """A journal that cannot be used; the text names the file and what is wrong with it."""


class JournalFiles(ABC, Generic[R]):
    """A SQLite file with what is rare, and beside it the steps since; held exclusively.

    Parameters
    ----------
    path : Path
        Of the database.
    scenario : str
        Fingerprint of the scenario that the journal belongs to.

    Attributes
    ----------
    offer, coin, measurement
        The step that followed the record, once that was read (:meth:`load`).

    Raises
    ------
    JournalError
        When they cannot be used.
    """

    kind = ""
    tables = ""
    adapter: ClassVar[TypeAdapter[Any]]

    def __init__(self, path: Path, scenario: str) -> None:
        self.path = path
        self._beside = path.with_name(path.name + STEPS)
        self.offer: Offer | None = None
        self.coin = NO_SYMBOL
        self.measurement: Measurement | None = None
        self._body: bytes | None = None
        self._rows: list[Actions] = []
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
            self._steps = StepLog(self._beside, self._open(scenario))
            self._read()
        except (sqlite3.Error, UnicodeDecodeError) as error:
            self._db.close()
            reason = (
                "another process is using it"
                if "locked" in str(error)
                else f"not a journal: {error}"
            )
            raise JournalError(f"{path}: {reason}") from None
        except OSError as error:
            self._db.close()
            raise JournalError(f"{self._beside}: cannot be opened: {error}") from None
        except JournalError:
            self._db.close()
            raise

    def _open(self, scenario: str) -> bytes:
        """Open or make the database; returns the tag of its steps."""
        db = self._db
        # A save rewrites one page and a checkpoint flushes them all: small pages cost less of both.
        db.execute("PRAGMA page_size=1024")
        db.execute("PRAGMA locking_mode=EXCLUSIVE")
        db.execute("PRAGMA journal_mode=WAL")
        db.execute("PRAGMA synchronous=NORMAL")
        db.execute("PRAGMA secure_delete=ON")
        db.execute("BEGIN IMMEDIATE")
        db.execute("CREATE TABLE IF NOT EXISTS meta (name TEXT PRIMARY KEY, value TEXT)")
        expected = {"kind": self.kind, "version": str(JOURNAL_VERSION), "scenario": scenario}
        found = dict(db.execute("SELECT name, value FROM meta"))
        for name, value in expected.items():
            if found.setdefault(name, value) != value:
                db.execute("ROLLBACK")
                raise JournalError(f"{self.path}: {name}: got {found[name]!r}, expected {value!r}")
        found.setdefault("tag", os.urandom(TAG_BYTES).hex())
        db.executemany("INSERT OR IGNORE INTO meta VALUES (?, ?)", found.items())
        db.execute(
            "CREATE TABLE IF NOT EXISTS record "
            "(id INTEGER PRIMARY KEY, number INTEGER, body BLOB, offer BLOB, coin INTEGER, "
            "check_ INTEGER)"
        )
        for table in (_RAW, *self.tables.split(";")):
            db.execute(table)
        db.execute("COMMIT")
        if (wrong := db.execute("PRAGMA quick_check(1)").fetchone()[0]) != "ok":
            raise sqlite3.DatabaseError(" ".join(wrong.split()))
        try:
            return bytes.fromhex(found["tag"])
        except ValueError:
            raise sqlite3.DatabaseError("its tag is none") from None

    def _read(self) -> None:
        """Find the last write: in the database, or among the steps that follow it."""
        self._found: Entry | None = None
        for number, body, offer, coin in self._rows_kept(
            "SELECT number, body, offer, coin, check_ FROM record"
        ):
            self._found = Entry(number, body, offer, coin=coin)
        try:
            entries = self._steps.read(0 if self._found is None else self._found.number)
        except Damaged as error:
            self._steps.close()
            raise JournalError(f"{self._beside}: {error}") from None
        self._logged = [entry.row for entry in entries if entry.row is not None]
        if entries:
            self._found = entries[-1]
        self._number = 0 if self._found is None else self._found.number
        self._begun = self._found is not None and self._found.begun

    def _execute(self, statement: str, values: Sequence[Any] = ()) -> list[Any]:
        try:
            return self._db.execute(statement, values).fetchall()
        except (sqlite3.Error, UnicodeDecodeError) as error:
            raise JournalError(f"{self.path}: {error}") from None

    def _rows_kept(self, statement: str, values: Sequence[Any] = ()) -> list[list[Any]]:
        """Rows that a statement selects, whose last column is the check of the others."""
        rows = []
        for *row, check in self._execute(statement, values):
            if check != check_of(*row):
                raise JournalError(f"{self.path}: a row is not as it was written")
            rows.append(row)
        return rows

    def load(self) -> R | None:
        """The record as last saved when the journal was opened, or None in a new one.

        The step that followed it is in :attr:`offer`, :attr:`coin` and :attr:`measurement`.

        Raises
        ------
        JournalError
            When they are none.
        """
        found = self._found
        if found is None:
            return None
        self._body = found.record
        try:
            record: R = self.adapter.validate_json(self._body)
            if found.offer:
                self.offer, self.coin = Offer.from_wire(found.offer), found.coin
            if found.measurement:
                self.measurement = Measurement.from_wire(found.measurement)
        except ValidationError as error:
            raise JournalError(
                f"{self.path}: record: {error.error_count()} fields are not as expected"
            ) from None
        return record

    def contributions(self, session: str | None) -> list[Contribution]:
        """Rows of the session's key blocks that are still needed, in order."""
        self._rows_of = session
        rows = self._rows_kept("SELECT session, j, steps, offer, measurement, check_ FROM raw")
        found = {row[0]: Contribution(*row) for of, *row in rows if of == session}
        found |= {contribution.j: contribution for contribution in self._logged}
        return [found[j] for j in sorted(found)]

    def save(self, actions: Actions) -> None:
        """Keep what they save; only a ``later`` record waits for the next step."""
        record = actions.record
        if record is None:
            if self._rare and not self._begun:
                self._write()
            self._log(actions.offer, actions.coin, actions.measurement)
            if actions.measurement is not None:
                self._body = None
            return
        self._body = self.adapter.dump_json(record)
        if record.session != self._rows_of:
            self._rows_of, self._forget = record.session, True
            self._logged.clear()
        if actions.contribution is not None or actions.obsolete_rows:
            self._rows.append(actions)
        if actions.for_tables:
            with self._transaction(actions.offer, actions.coin):
                self._add_to_tables(actions)
        elif not actions.later:
            self._write(actions.offer, actions.coin)
        self._steps.make_ready()

    @abstractmethod
    def _add_to_tables(self, actions: Actions) -> None:
        """Put what comes along with a record into this side's own tables."""

    def _write_rows(self) -> None:
        """Within a transaction."""
        if self._forget:
            self._execute("DELETE FROM raw WHERE session IS NOT ?", (self._rows_of,))
        staged = [
            actions
            for actions in self._rows
            if actions.record is not None and actions.record.session == self._rows_of
        ]
        for contribution in (
            *self._logged,
            *(actions.contribution for actions in staged if actions.contribution is not None),
        ):
            row = (self._rows_of, *contribution)
            self._execute(
                "INSERT OR REPLACE INTO raw VALUES (?, ?, ?, ?, ?, ?)", (*row, check_of(*row))
            )
        for over in (over for actions in staged for over in actions.obsolete_rows):
            self._execute(
                "DELETE FROM raw WHERE session = ? AND j >= ? AND j < ?",
                (self._rows_of, over.start, over.stop),
            )

    @contextmanager
    def _transaction(self, offer: Offer | None, coin: int) -> Iterator[None]:
        """A rare write: all or nothing, of the staged record and the step begun; the log is empty.

        A step that was read is always logged: it is what a message waits for.
        """
        offered = b"" if offer is None else offer.wire()
        row = (self._number + 1, self._staged, offered, coin)
        self._execute("BEGIN IMMEDIATE")
        yield
        self._write_rows()
        self._execute(
            "INSERT OR REPLACE INTO record VALUES (0, ?, ?, ?, ?, ?)", (*row, check_of(*row))
        )
        self._execute("COMMIT")
        self._number, self._begun, self._forget = row[0], offer is not None, False
        self._rows.clear()
        self._logged.clear()
        with self._named():
            self._steps.clear()

    @property
    def _staged(self) -> bytes:
        """The record that the next step follows."""
        assert self._body is not None, "the step before has not been counted"
        return self._body

    def _write(self, offer: Offer | None = None, coin: int = NO_SYMBOL) -> None:
        """The staged record, and the step that is begun, if one is."""
        if self._rare:
            with self._transaction(offer, coin):
                pass
        else:
            self._log(offer, coin)

    @property
    def _rare(self) -> bool:
        """Whether what is staged needs a rare write."""
        rows = self._rows
        return (
            self._forget
            or len(rows) > 1
            or any(actions.obsolete_rows for actions in rows)
            or self._steps.size > LARGEST_STEP
        )

    def _log(self, offer: Offer | None, coin: int, measurement: Measurement | None = None) -> None:
        """The staged record and the step that follows it, if one does."""
        row = self._rows[0].contribution if len(self._rows) == 1 else None
        with self._named():
            self._steps.append(self._number + 1, self._staged, offer, coin, measurement, row)
        self._number += 1
        self._begun = offer is not None and measurement is None
        if row is not None:
            self._logged.append(row)
            self._rows.clear()

    @contextmanager
    def _named(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise JournalError(f"{self._beside}: {error.strerror}") from None

    def close(self) -> None:
        """Close the files; they can be opened again."""
        self._steps.close()
        self._db.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
