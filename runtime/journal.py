"""Journals: what each end must not forget, saved before anything is sent.

A journal is one SQLite file. Its one row in the table ``step`` has the record of all that went
before, and the messages of the step that follows it: the one received and the one about to be sent.
That is all it takes to count the step again, so an end may send first and count afterwards, while
its partner works. The row has what keys need of every step, too: the newest transitions'
contributions to their block, and the digits that are left of the key in use. So a step is one
statement. Other tables hold what would be too much to write again in each step: contributions go
there eight at a time, and keys a block at a time.

Every save is one transaction: all or nothing. On return it survives ``kill -9`` of the process. A
*durable* save is on the disk, and with it all saves before: it survives a power failure, too. The
last saves that were not durable may then be missing; SQLite sees to it that what is left is the
journal as it was at some moment before. A journal that is opened after that, by another boot of the
machine, says so (:attr:`Loaded.fell_back`), and the plant begins a new session. A journal is held
by one process at a time.

What is erased is overwritten with zeros in the file, and in the write-ahead log beside it once that
has been written over: within some 4,000 saves, or when the journal is closed.
"""

import os
import sqlite3
import weakref
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from struct import Struct
from typing import Any, ClassVar, Final, Generic, Self
from zlib import crc32

from pydantic import TypeAdapter, ValidationError

from protocol.agreement import NO_SYMBOL
from protocol.link.effects import Save
from protocol.link.records import INITIAL_ID, ControllerRecord, Loaded, PlantRecord, R
from protocol.link.step import IDLE, Answered, Begun, Read, Step
from protocol.messages import Measurement, Offer, SendCommand
from protocol.secret.nonces import Contribution
from protocol.secret.stream import NO_PART, BlockKeys, Held, Part
from runtime.errors import Failure
from runtime.files import make_folder, open_private

JOURNAL_VERSION: Final = 15

REMEMBERED: Final = 1000
"""Delivered messages whose identifiers are remembered, so that none is queued twice."""

BATCH: Final = 8
"""Contributions that go to their table together; until then they stand in the step's row."""

PAGE_BYTES: Final = 2048
"""A step takes 700 to 1,900 bytes: its row is one page, and a save writes no more than that."""

CHECKPOINT_PAGES: Final = 2000
"""Pages of the write-ahead log after which SQLite copies it into the file, with two syncs."""

BOOT_ID: Final = Path("/proc/sys/kernel/random/boot_id")

_STEP: Final = "INSERT OR REPLACE INTO step VALUES (0, ?, ?)"

_LENGTHS: Final = Struct(">IIIq")
"""What a step's row begins with: bytes of the record, the offer and the measurement, and the
coin."""

_CONTRIBUTION: Final = Struct(">qqB32s32s")
"""As it stands in the step's row: j, steps, which of the two nonces count, and both."""

_PART: Final = Struct(">qqH")
"""Of the key in use: block, the first digit's number, and how many digits follow."""

Statement = tuple[str, tuple[Any, ...]]
"""An SQL statement, and its values."""


class JournalError(Failure):
    """A journal that cannot be used; the text names the file and what is wrong with it."""


class Journal(ABC, Generic[R]):
    """A SQLite file, held exclusively.

    Parameters
    ----------
    path : Path, optional
        None: in memory, for simulations. Such a journal outlives the end that writes it.
    scenario : str
        Fingerprint of the scenario that the journal belongs to.

    Raises
    ------
    JournalError
        Here and later, when it cannot be used.
    """

    kind = ""
    adapter: ClassVar[TypeAdapter[Any]]
    tables: ClassVar[tuple[str, ...]] = (
        "step (id INTEGER PRIMARY KEY, step BLOB, check_ INTEGER)",
        "row (batch INTEGER PRIMARY KEY, rows BLOB, check_ INTEGER)",
        "stream (block INTEGER PRIMARY KEY, first INTEGER, keys BLOB, check_ INTEGER)",
    )
    """The last column of each is the check of the others."""

    of_session: ClassVar[tuple[str, ...]] = ("row", "stream")
    """Tables whose rows belong to the record's session, and go with it."""

    def __init__(self, path: Path | None, scenario: str) -> None:
        self.path = path
        self._fell_back = False
        self._boot_due: str | None = None
        """This boot, as long as the session that another one cut has not ended."""
        self._saved: R | None = None
        """The record that was saved last."""
        self._rows: dict[int, bytes] = {}
        """Contributions that are in the step's row, by transition."""
        try:
            if path is not None:
                make_folder(path.parent)
                os.close(open_private(path, os.O_RDWR | os.O_CREAT))  # SQLite takes over its mode
            self.db = sqlite3.connect(
                path or ":memory:", isolation_level=None, timeout=2.0, check_same_thread=False
            )
        except (OSError, sqlite3.Error) as error:
            raise JournalError(f"{path}: cannot be opened: {error}") from None
        weakref.finalize(self, self.db.close)  # of one in memory that nobody closes
        try:
            self._open({"kind": self.kind, "version": str(JOURNAL_VERSION), "scenario": scenario})
            self.load()
        except (sqlite3.Error, UnicodeDecodeError) as error:
            self.db.close()
            locked = "locked" in str(error)
            reason = "another process is using it" if locked else f"not a journal: {error}"
            raise JournalError(f"{path}: {reason}") from None
        except JournalError:
            self.db.close()
            raise

    def _open(self, expected: dict[str, str]) -> None:
        """Open the tables, or make them; the boot of the machine is on the disk on return.

        Where another boot cut a session, that one's name stays until the session has ended: a
        process that dies before is followed by one that ends it.
        """
        db, boot = self.db, _boot()
        db.execute(f"PRAGMA page_size={PAGE_BYTES}")
        db.execute("PRAGMA locking_mode=EXCLUSIVE")
        db.execute("PRAGMA journal_mode=WAL")
        db.execute("PRAGMA synchronous=FULL")
        db.execute("PRAGMA secure_delete=ON")
        db.execute(f"PRAGMA wal_autocheckpoint={CHECKPOINT_PAGES}")
        db.execute("BEGIN IMMEDIATE")
        db.execute("CREATE TABLE IF NOT EXISTS meta (name TEXT PRIMARY KEY, value TEXT)")
        found = dict(db.execute("SELECT name, value FROM meta"))
        for name, value in expected.items():
            if found.setdefault(name, value) != value:
                db.execute("ROLLBACK")
                raise JournalError(f"{self.path}: {name}: got {found[name]!r}, expected {value!r}")
        self._fell_back = found.get("boot", "") not in ("", boot)
        if self._fell_back:
            self._boot_due = boot
        else:
            found["boot"] = boot
        db.executemany("INSERT OR REPLACE INTO meta VALUES (?, ?)", found.items())
        for table in self.tables:
            db.execute(f"CREATE TABLE IF NOT EXISTS {table}")
        db.execute("COMMIT")
        db.execute("PRAGMA synchronous=NORMAL")
        if (wrong := db.execute("PRAGMA quick_check(1)").fetchone()[0]) != "ok":
            raise sqlite3.DatabaseError(" ".join(wrong.split()))

    # --- rows -------------------------------------------------------------------------------------

    def _row(self, table: str, *values: Any) -> Statement:
        """The statement that writes a row, with its check."""
        marks = ", ".join("?" * (len(values) + 1))
        return f"INSERT OR REPLACE INTO {table} VALUES ({marks})", (*values, check_of(*values))

    def _get(self, table: str, where: str = "TRUE", *values: Any) -> list[list[Any]]:
        """The rows of a table for which ``where`` holds, in order of their first column.

        Raises
        ------
        JournalError
            When one is not as it was written.
        """
        try:
            statement = f"SELECT * FROM {table} WHERE {where} ORDER BY 1"
            found = self.db.execute(statement, values).fetchall()
        except (sqlite3.Error, UnicodeDecodeError) as error:
            raise JournalError(f"{self.path}: {error}") from None
        for *row, check in found:
            if check != check_of(*row):
                raise JournalError(f"{self.path}: {table}: a row is not as it was written")
        return [row for *row, _ in found]

    # --- the step ---------------------------------------------------------------------------------

    def load(self) -> Loaded[R]:
        """What was saved last."""
        self._saved, self._rows = None, {}
        batches = [rows for _, rows in self._get("row")]
        keys = tuple(BlockKeys(*row) for row in self._get("stream"))
        for _, row in self._get("step"):
            record, offer, measurement, coin, of_keys = _of_row(row)
            part, newest = _keys_of(of_keys)
            self._rows = {row.j: _packed(row) for row in _unpacked(newest)}
            try:
                loaded: Loaded[R] = Loaded(
                    self.adapter.validate_json(record),
                    _step_of(offer, coin, measurement),
                    tuple(_unpacked(b"".join((*batches, newest)))),
                    Held(part, keys),
                    self._symbols(),
                    self._fell_back,
                )
            except ValidationError as error:
                text = f"step: {error.error_count()} fields are not as expected"
                raise JournalError(f"{self.path}: {text}") from None
            self._saved = loaded.record
            return loaded
        return Loaded()

    def _symbols(self) -> str:
        """The symbols of the frame under way that are in a table of their own."""
        return ""

    def save(self, save: Save) -> None:
        """Save the record, the step that follows it, and what comes along, in one transaction."""
        execute = self.db.execute
        try:
            if save.durable:
                execute("PRAGMA synchronous=FULL")
            beside = self._of_keys(save)
            beside += self._more(save)
            if beside:
                execute("BEGIN IMMEDIATE")
                for statement in beside:
                    execute(*statement)
            row = self._step(save)
            execute(_STEP, (row, crc32(row, _ID_CHECK)))  # by itself it is a transaction
            if beside:
                execute("COMMIT")
            if save.durable:
                execute("PRAGMA synchronous=NORMAL")
        except sqlite3.Error as error:
            with suppress(sqlite3.Error):
                execute("ROLLBACK")
            raise JournalError(f"{self.path}: {error}") from None
        self._saved = save.record  # type: ignore[assignment]

    def _step(self, save: Save) -> bytes:
        """The step's row: lengths, record, offer, measurement, and what keys need of every step.

        It is one column: SQLite takes more time for each one than for all the bytes.
        """
        record = self.adapter.serializer.to_json(save.record)
        offer, coin, measurement = _columns(save.step)
        lengths = _LENGTHS.pack(len(record), len(offer), len(measurement), coin)
        if not self._rows and save.rows.part == NO_PART:
            return b"".join((lengths, record, offer, measurement))
        block, first, digits = save.rows.part
        part = _PART.pack(block, first, len(digits))
        keys = self._rows.values()
        return b"".join((lengths, record, offer, measurement, part, digits, *keys))

    def _of_keys(self, save: Save) -> list[Statement]:
        """What is written of key blocks and of the key stream beside the step's row."""
        contributions, obsolete, of_blocks, _ = save.rows
        statements: list[Statement] = []
        if self._saved is None or save.record.session.id != self._saved.session.id:
            self._rows = {}
            if self._boot_due is not None:
                boot = "UPDATE meta SET value = ? WHERE name = 'boot'"
                statements.append((boot, (self._boot_due,)))
                self._boot_due = None
            statements += [(f"DELETE FROM {table}", ()) for table in self.of_session]
        if obsolete:
            statements += self._without(obsolete)
        for row in contributions:
            if not (obsolete and _within(row.j, obsolete)):
                self._rows[row.j] = _packed(row)
            if row.j % BATCH == BATCH - 1 and self._rows:
                batch = b"".join(self._rows.values())
                statements.append(self._row("row", row.j // BATCH, batch))
                self._rows = {}
        for keys in of_blocks:
            if keys.keys:
                statements.append(self._row("stream", *keys))
            else:
                statements.append(("DELETE FROM stream WHERE block = ?", (keys.block,)))
        return statements

    def _without(self, obsolete: tuple[range, ...]) -> Iterator[Statement]:
        """Drop the contributions of these transitions; of a batch at an edge the others stay.

        Blocks that are over at once may meet in one batch, which is written once for all of them.
        """
        edges = {j // BATCH for over in obsolete for j in (over.start, over.stop - 1)}
        self._rows = {j: row for j, row in self._rows.items() if not _within(j, obsolete)}
        for over in obsolete:
            between = (over.start // BATCH, (over.stop - 1) // BATCH)
            yield "DELETE FROM row WHERE batch > ? AND batch < ?", between
        for batch in edges:
            for _, rows in self._get("row", "batch = ?", batch):
                left = [_packed(row) for row in _unpacked(rows) if not _within(row.j, obsolete)]
                if left:
                    yield self._row("row", batch, b"".join(left))
                else:
                    yield "DELETE FROM row WHERE batch = ?", (batch,)

    @abstractmethod
    def _more(self, save: Save) -> Iterator[Statement]:
        """What is written in this side's own tables."""

    def forget(self) -> None:
        """Lose all that was saved; for simulations."""
        for table in self.tables:
            self.db.execute(f"DELETE FROM {table.split()[0]}")
        self.load()

    def close(self) -> None:
        """Close the file, which is then whole on the disk; it can be opened again."""
        with suppress(sqlite3.Error):
            self.db.execute("UPDATE meta SET value = '' WHERE name = 'boot'")
        self.db.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class ControllerJournal(Journal[ControllerRecord]):
    """The controller's, with the queue of messages that it has to deliver.

    A message that was delivered leaves its number, its identifier and a CRC-32.

    Attributes
    ----------
    queued : int
        How many messages were ever queued; they are numbered from 0.
    """

    kind = "controller"
    adapter = TypeAdapter(ControllerRecord)
    tables = (
        *Journal.tables,
        "outbox (number INTEGER PRIMARY KEY, id TEXT UNIQUE, crc INTEGER, payload BLOB,"
        " check_ INTEGER)",
    )

    queued: int

    def load(self) -> Loaded[ControllerRecord]:
        """What was saved last."""
        last = self._get("outbox", "number = (SELECT MAX(number) FROM outbox)")
        self.queued = last[0][0] + 1 if last else 0
        return super().load()

    def _more(self, save: Save) -> Iterator[Statement]:
        record = save.record
        assert isinstance(record, ControllerRecord)
        if save.queued is not None:
            yield self._queue(save.queued)
        delivered = 0 if self._saved is None else self._saved.frame.message
        for number in range(delivered, record.frame.message):
            for _, identifier, crc, _ in self._get("outbox", "number = ?", number):
                yield self._row("outbox", number, identifier, crc, None)
            old = (number - REMEMBERED, INITIAL_ID)
            yield "DELETE FROM outbox WHERE number = ? AND id <> ?", old

    def enqueue(self, command: SendCommand) -> None:
        """Add a message to the queue."""
        self.db.execute(*self._queue(command))

    def _queue(self, command: SendCommand) -> Statement:
        self.queued += 1
        payload = command.payload
        return self._row("outbox", self.queued - 1, command.id, crc32(payload), payload)

    def crc_of(self, identifier: str) -> int | None:
        """The CRC-32 of the message that was queued under this identifier, or None."""
        return next((crc for _, _, crc, _ in self._get("outbox", "id = ?", identifier)), None)

    def _numbered(self, number: int) -> list[Any]:
        rows = self._get("outbox", "number = ?", number)
        if not rows:
            raise JournalError(f"{self.path}: message {number} is missing")
        return rows[0]

    def payload(self, number: int) -> bytes | None:
        """Message ``number``; None while it is not queued, and once it was delivered."""
        if number >= self.queued:
            return None
        payload: bytes | None = self._numbered(number)[3]
        return payload

    def identifier(self, number: int) -> str:
        """Identifier of the queued message ``number``."""
        identifier: str = self._numbered(number)[1]
        return identifier

    def waiting(self) -> list[tuple[int, str, bytes]]:
        """Number, identifier and text of the messages that were not delivered yet, in order."""
        rows = self._get("outbox", "payload IS NOT NULL")
        return [(number, identifier, payload) for number, identifier, _, payload in rows]


class PlantJournal(Journal[PlantRecord]):
    """The plant's, with the symbols of the frame under way and the message received last."""

    kind = "plant"
    adapter = TypeAdapter(PlantRecord)
    tables = (
        *Journal.tables,
        "frame (place INTEGER PRIMARY KEY, symbols TEXT, check_ INTEGER)",
        "inbox (id INTEGER PRIMARY KEY, payload BLOB, check_ INTEGER)",
    )

    def _symbols(self) -> str:
        return "".join(symbols for _, symbols in self._get("frame"))

    def _more(self, save: Save) -> Iterator[Statement]:
        record = save.record
        assert isinstance(record, PlantRecord)
        if self._saved is not None and record.frame.stored < self._saved.frame.stored:
            yield "DELETE FROM frame", ()
        if save.symbols:
            yield self._row("frame", record.frame.stored, save.symbols)
        if save.received is not None:
            yield self._row("inbox", 0, save.received)

    def last_message(self) -> bytes | None:
        """The message that was received last, or None."""
        return next((payload for _, payload in self._get("inbox")), None)


def _columns(step: Step) -> tuple[bytes, int, bytes]:
    """Offer, coin and measurement of the step's row."""
    match step:
        case Begun(offer, coin):
            return offer.wire(), coin, b""
        case Read(offer, coin, report):
            return offer.wire(), coin, report.wire()
        case Answered(measurement, offer):
            return offer.wire(), NO_SYMBOL, measurement.wire()
    return b"", NO_SYMBOL, b""


def _of_row(row: bytes) -> tuple[bytes, bytes, bytes, int, bytes]:
    """Record, offer, measurement, coin and keys of a step's row."""
    *lengths, coin = _LENGTHS.unpack_from(row)
    begins, parts = _LENGTHS.size, []
    for length in lengths:
        parts.append(row[begins : begins + length])
        begins += length
    record, offer, measurement = parts
    return record, offer, measurement, coin, row[begins:]


def _step_of(offer: bytes, coin: int, measurement: bytes) -> Step:
    """The step of a step's row."""
    if not offer:
        return IDLE
    if not measurement:
        return Begun(Offer.from_wire(offer), coin)
    said = Measurement.from_wire(measurement)
    if coin == NO_SYMBOL:
        return Answered(said, Offer.from_wire(offer))
    return Read(Offer.from_wire(offer), coin, said)


def _keys_of(keys: bytes) -> tuple[Part, bytes]:
    """The key in use, and the newest contributions, of this column."""
    if not keys:
        return NO_PART, b""
    block, first, count = _PART.unpack_from(keys)
    rest = keys[_PART.size :]
    return Part(block, first, rest[:count]), rest[count:]


def _within(j: int, ranges: tuple[range, ...]) -> bool:
    """Whether a transition is of one of these."""
    return any(j in one for one in ranges)


def _packed(row: Contribution) -> bytes:
    j, steps, offer, measurement = row
    return _CONTRIBUTION.pack(j, steps, row.counts, offer or b"", measurement or b"")


def _unpacked(rows: bytes) -> Iterator[Contribution]:
    for j, steps, counts, offer, measurement in _CONTRIBUTION.iter_unpack(rows):
        yield Contribution(
            j, steps, offer if counts & 1 else None, measurement if counts & 2 else None
        )


def check_of(*values: str | bytes | float | None) -> int:
    """CRC-32 of a row's columns, which shows a flipped bit.

    It depends on the columns, so it is erased together with them.
    """
    texts = [value if isinstance(value, bytes) else str(value).encode() for value in values]
    return crc32(b"\0".join(texts))


_ID_CHECK: Final = crc32(b"0\0")
"""What the check of the step's row begins with, as :func:`check_of` makes it."""


def _boot() -> str:
    """Random id of this boot of the machine; empty where the system tells none."""
    try:
        return BOOT_ID.read_text(encoding="ascii").strip()
    except OSError:
        return ""
