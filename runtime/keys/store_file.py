"""The file of a key store: SQLite, mode 0600, without remains of what was erased."""

import os
import sqlite3
import threading
import weakref
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, Final, Self
from zlib import crc32

from protocol.secret.records import Side, StoreError
from runtime.files import make_folder, open_private
from runtime.keys.anchor import Anchor

STORE_VERSION: Final = 3

UNREADABLE: Final = (sqlite3.Error, UnicodeDecodeError)
"""What a damaged file raises. SQLite's message may quote bytes that are no text."""

BUSY_S: Final = 30.0
"""Seconds to wait for another process's transaction: the key maker comes after the loops."""

_TABLES: Final = """
CREATE TABLE IF NOT EXISTS meta (name TEXT PRIMARY KEY, value TEXT, check_ INTEGER);
CREATE TABLE IF NOT EXISTS block (
    place INTEGER PRIMARY KEY, session TEXT NOT NULL, number INTEGER NOT NULL,
    transitions INTEGER NOT NULL, steps INTEGER NOT NULL, counted INTEGER NOT NULL,
    rows INTEGER NOT NULL, keys INTEGER NOT NULL, state TEXT NOT NULL, t_ns INTEGER NOT NULL,
    tag TEXT NOT NULL, check_ INTEGER, UNIQUE (session, number));
CREATE TABLE IF NOT EXISTS key (
    place INTEGER PRIMARY KEY AUTOINCREMENT, id TEXT UNIQUE NOT NULL, block INTEGER NOT NULL,
    row INTEGER NOT NULL, own INTEGER NOT NULL, state TEXT NOT NULL, body BLOB, check_ INTEGER,
    t_ns INTEGER, who TEXT, use TEXT, there TEXT);
CREATE INDEX IF NOT EXISTS key_use ON key (use);
CREATE INDEX IF NOT EXISTS key_there ON key (there);
CREATE TABLE IF NOT EXISTS asked (
    use TEXT PRIMARY KEY, what TEXT NOT NULL, names TEXT NOT NULL, refused TEXT);
CREATE TABLE IF NOT EXISTS lost (name TEXT PRIMARY KEY);
CREATE TABLE IF NOT EXISTS doubtful (block INTEGER PRIMARY KEY);
CREATE INDEX IF NOT EXISTS key_ready ON key (own, state, place);
CREATE INDEX IF NOT EXISTS key_block ON key (block);
CREATE TABLE IF NOT EXISTS pad (
    place INTEGER PRIMARY KEY, origin TEXT UNIQUE NOT NULL, kind TEXT NOT NULL, state TEXT NOT NULL,
    session TEXT, body BLOB, check_ INTEGER);
CREATE INDEX IF NOT EXISTS pad_session ON pad (session);
"""


def check_of(*values: Any) -> int:
    """CRC-32 of a row's columns, which shows a flipped bit.

    It depends on the columns, so it is erased together with them.
    """
    return crc32(repr(values).encode())


def _inode(path: Path | None) -> tuple[int, int] | None:
    """Device and inode of the file at ``path``; (0, 0) where there is none."""
    try:
        found = None if path is None else path.stat()
    except OSError:
        return 0, 0
    return None if found is None else (found.st_dev, found.st_ino)


class StoreFile:
    """A key store's file: its tables, transactions and notes.

    Parameters
    ----------
    path : Path, optional
        None: in memory, for simulations.
    side : {"controller", "plant"}
        Whose store it is.
    create : bool
        Make the file (mode 0600) and its folder where they are missing.

    Raises
    ------
    StoreError
        When the file is missing, cannot be opened, is damaged, belongs to another side or version,
        or is an older copy of itself.
    """

    def __init__(self, path: Path | None, side: Side, *, create: bool = False) -> None:
        self.path = path
        self.side: Side = side
        self._lock = threading.RLock()
        self._anchor = None if path is None else Anchor(path)
        self._gives = False
        self._opened: tuple[int, int] | None = None
        try:
            if path is None:
                pass
            elif create:
                make_folder(path.parent)
                os.close(open_private(path, os.O_RDWR | os.O_CREAT))  # its journal gets this mode
            elif not path.is_file():
                raise StoreError(f"{path}: no key store is there: no key was ever made here")
            # autocommit: transactions are begun by hand
            self.db = sqlite3.connect(
                path or ":memory:", isolation_level=None, timeout=BUSY_S, check_same_thread=False
            )
            weakref.finalize(self, self.db.close)  # whoever drops a store has closed it
            self._opened = _inode(path)
        except (OSError, sqlite3.Error) as error:
            raise StoreError(f"{path}: cannot be opened: {error}") from None
        try:
            self._open(create)
        except UNREADABLE as error:
            self.db.close()
            raise StoreError(f"{path}: not a key store: {error}") from None
        except StoreError:
            self.db.close()
            raise

    def _open(self, create: bool) -> None:
        db = self.db
        # No write-ahead log: erased bytes would live on in it. A rollback journal is cut to nothing
        # at each commit, and it has the database's own mode.
        db.execute("PRAGMA journal_mode=TRUNCATE")
        db.execute("PRAGMA synchronous=FULL")
        db.execute("PRAGMA secure_delete=ON")
        db.execute("PRAGMA temp_store=MEMORY")
        with self.transaction():
            for statement in _TABLES.split(";"):
                db.execute(statement)
            for name, value in (("version", str(STORE_VERSION)), ("side", self.side)):
                found = self.note(name)
                if found is None:
                    self.set_note(name, value)
                elif found != value:
                    raise StoreError(f"{self.path}: {name}: got {found!r}, expected {value!r}")
        self._look_through("integrity_check" if create else "quick_check")
        if self._anchor is not None:
            with self.transaction():  # nobody else is between the two
                self._anchor.compare(self._given())

    def _look_through(self, how: str = "quick_check") -> None:
        """Check the notes, and the file's pages by SQLite's own check.

        A copy of a file in use may hold an index that does not fit its table. Only
        ``integrity_check`` sees that. It takes 8 s for a million keys; a service runs it once, at
        its start.
        """
        for (name,) in self.db.execute("SELECT name FROM meta").fetchall():
            self.note(name)
        if (wrong := self.db.execute(f"PRAGMA {how}(1)").fetchone()[0]) != "ok":
            raise sqlite3.DatabaseError(" ".join(wrong.split()))

    @classmethod
    def copy_of(cls, path: Path, side: Side) -> Self:
        """A copy in memory of the store at ``path``, for reading.

        Nothing is written in its folder, even while a service has it open. One exception: a
        transaction that a death cut short is rolled back first.

        Raises
        ------
        StoreError
            As for the constructor.
        """
        if not path.is_file():
            raise StoreError(f"{path}: no key store is there: no key was ever made here")
        store = cls(None, side)
        store.path = path
        try:
            try:
                store._fill_from(path)
            except sqlite3.OperationalError:
                cls(path, side).close()
                store._fill_from(path)
            store._look_through()
            for name, value in (("version", str(STORE_VERSION)), ("side", side)):
                if (found := store.note(name)) != value:
                    raise StoreError(f"{path}: {name}: got {found!r}, expected {value!r}")
            Anchor(path).look(store._given())
        except UNREADABLE as error:
            store.close()
            raise StoreError(f"{path}: not a key store: {error}") from None
        except StoreError:
            store.close()
            raise
        return store

    def _fill_from(self, path: Path) -> None:
        uri = f"{path.absolute().as_uri()}?mode=ro"
        with closing(sqlite3.connect(uri, uri=True, timeout=BUSY_S)) as db:
            db.execute("SELECT COUNT(*) FROM meta").fetchone()
            db.backup(self.db)

    def _given(self) -> int:
        return int(self.note("given") or 0)

    def gives(self) -> None:
        """Count the transaction under way, beside the store, as one that gives something away."""
        self._gives = True

    def expect(self, row: Sequence[Any], what: str) -> None:
        """Check a row, whose last column is its CRC-32.

        Raises
        ------
        StoreError
            When it is not as it was written; ``what`` names it.
        """
        *values, check = row
        if check_of(*values) != check:
            raise StoreError(f"{self.path}: {what} is not as it was written")

    @contextmanager
    def transaction(self) -> Iterator[sqlite3.Connection]:
        """A transaction: all or nothing, on disk when it ends, one at a time over all processes.

        Raises
        ------
        StoreError
            When the file cannot be read or written.
        """
        with self._lock:
            self.stay()
            try:
                self.db.execute("BEGIN IMMEDIATE")
                self._gives = False
                try:
                    yield self.db
                    gave = self._gives
                    if gave:
                        given = self._given() + 1
                        self.set_note("given", str(given))
                        if self._anchor is not None:
                            self._anchor.announce(given)
                except BaseException:
                    self.db.execute("ROLLBACK")
                    raise
                self.db.execute("COMMIT")
                if gave and self._anchor is not None:
                    self._anchor.count(given)
            except UNREADABLE as error:
                raise StoreError(f"{self.path}: {error}") from None

    def rows(self, statement: str, values: Sequence[Any] = ()) -> list[Any]:
        """The rows that a query finds.

        Raises
        ------
        StoreError
            When the file cannot be read.
        """
        with self._lock:
            self.stay()
            try:
                return self.db.execute(statement, values).fetchall()
            except UNREADABLE as error:
                raise StoreError(f"{self.path}: {error}") from None

    def stay(self) -> None:
        """Check that the file has not been moved away or replaced while it is open.

        SQLite finds its rollback journal by name, so the old and the new file would spoil each
        other.

        Raises
        ------
        StoreError
            When it has been.
        """
        if self._opened is not None and _inode(self.path) != self._opened:
            raise StoreError(
                f"{self.path}: it is gone, or another one is in its place: start again"
            )

    # --- notes ------------------------------------------------------------------------------------

    def note(self, name: str) -> str | None:
        """The note ``name`` of the store, or None."""
        rows = self.rows("SELECT * FROM meta WHERE name = ?", (name,))
        if not rows:
            return None
        self.expect(rows[0], f"its note {name!r}")
        return str(rows[0][1])

    def set_note(self, name: str, value: str) -> None:
        """Write the note ``name``."""
        with self._lock:
            row = (name, value, check_of(name, value))
            self.rows("INSERT OR REPLACE INTO meta VALUES (?, ?, ?)", row)

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            self.db.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
