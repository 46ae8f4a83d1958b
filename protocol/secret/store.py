"""The key store: one SQLite file a side, confirmed before delivered, delivered once.

A key is ``stored`` when its block has closed here, ``confirmed`` once the partner has shown the
same tag, and ``delivered`` when it was handed out: its bytes are erased in that same transaction,
before anyone sees them, and its row stays as a tombstone. A process that dies in between loses a
key, and never gives one twice. ``dropped`` are keys whose block differed, or that nobody fetched
until the store was full.

The two ends own disjoint halves, odd rows the controller and even rows the plant, so each hands out
its own half without asking (`KeyStore.deliver`) and the partner finds the same key by its id
(`KeyStore.deliver_named`). Ids follow from session, block and row; both ends order alike.

Apart from the journal, because other processes open it too: a service that adds blocks, and a key
server that delivers.
"""

import sqlite3
import time
from collections.abc import Sequence
from typing import Final

from protocol.secret.records import (
    WHOLE,
    BlockRow,
    BlockTag,
    Counts,
    Key,
    KeysRefused,
    OthersKeys,
    Share,
    Side,
    State,
    StoreError,
    TooFewKeys,
    UnknownKeys,
    block_name,
    key_id,
)
from protocol.secret.store_file import StoreFile, check_of

MOST_KEYS: Final = 100_000
"""Undelivered keys that a side keeps of its own half: those among so many, the newest of the half.
Of the partner's half it keeps twice as many, so that none the partner still gives out is missing
here. Halves take turns, so that a key's place says how many are newer: no key is counted."""

TOMBSTONES: Final = 1_000_000

_BEGUN: Final = "begun"

_READY: Final = "own = 1 AND state = 'confirmed' AND (row - 1) / 2 % ? = ?"
"""Keys of a share of this side's own half that may be delivered."""


def _asked(share: Share) -> tuple[int, int]:
    return share.of, share.place


class KeyStore(StoreFile):
    """The keys of one side; it is opened as a :class:`StoreFile`."""

    @property
    def refused(self) -> str | None:
        """Why nobody gets a key of this store, or None: the run is seeded, or claims nothing."""
        return self.note("refused")

    def refuse(self, reason: str) -> None:
        """From here on, and after every start, no key of this store is handed out."""
        if self.refused is None:
            self.set_note("refused", reason)

    @property
    def assumption(self) -> str:
        """Under which claim the keys are secret, in words."""
        return self.note("assumption") or ""

    def begin(self, session: str | None, transitions: int) -> None:
        """Note, once, at which transition of which session this store was new."""
        if self.note(_BEGUN) is None:
            self.set_note(_BEGUN, f"{session}/{transitions}")

    def is_younger(self, session: str, first: int) -> bool:
        """Whether the block that begins at transition ``first`` began before this store did.

        Its keys may be in one that was removed, and given.
        """
        begun = self.note(_BEGUN)
        if begun is None:
            return False
        theirs, _, transitions = begun.rpartition("/")
        return theirs == session and first < int(transitions)

    # --- the service's side -----------------------------------------------------------------------

    def add(
        self,
        block: BlockRow,
        keys: Sequence[bytes],
        *,
        tag: str = "",
        pads: Sequence[tuple[Side, bytes]] = (),
    ) -> bool:
        """Keep a block with its keys, rows 1, 2, ...; on return it survives a power failure.

        Ids are what they must be, so that a block that is added again is found to be there.

        Parameters
        ----------
        block : BlockRow
            Its ``state`` says whether there is anything to confirm.
        keys : sequence of bytes
        tag : str
            This side's tag of the block.
        pads : sequence of (side, bytes)
            One-time pads that the block yields, for tags of blocks to come.

        Returns
        -------
        bool
            False when the block was there already; nothing has changed.
        """
        with self.transaction() as db:
            cursor = db.execute(
                "INSERT OR IGNORE INTO block VALUES (NULL, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
                (*block, tag, check_of(block.session, block.number, tag, block.keys)),
            )
            if cursor.rowcount == 0:
                return False
            place = cursor.lastrowid
            odd_is_own = self.side == "controller"
            rows = [
                (key_id(*at, row), row, int((row % 2 == 1) == odd_is_own), key)
                for at in [(block.session, block.number)]
                for row, key in enumerate(keys, 1)
            ]
            db.executemany(
                "INSERT INTO key VALUES (NULL, ?, ?, ?, ?, 'stored', ?, ?, NULL, NULL)",
                ((row[0], place, *row[1:], check_of(*row)) for row in rows),
            )
            origin = block_name(block.session, block.number)
            db.executemany(
                "INSERT OR IGNORE INTO pad VALUES (NULL, ?, ?, 'held', NULL, ?, ?)",
                ((side, origin, body, check_of(side, origin, body)) for side, body in pads),
            )
            self._make_room(db)
        return True

    def block_tag(self, session: str, number: int) -> BlockTag | None:
        """What was kept of a block, or None."""
        rows = self.rows(
            "SELECT state, session, number, tag, keys, check_ FROM block "
            "WHERE session = ? AND number = ?",
            (session, number),
        )
        if not rows:
            return None
        state, *row = rows[0]
        self.expect(row, f"block {number}")
        return BlockTag(state, *row[2:4])

    @staticmethod
    def _make_room(db: sqlite3.Connection) -> None:
        (newest,) = db.execute("SELECT MAX(place) FROM key").fetchone()
        for own, most in ((1, MOST_KEYS), (0, 2 * MOST_KEYS)):
            db.execute(
                "UPDATE key SET state = 'dropped', body = NULL, check_ = NULL WHERE own = ? "
                "AND state IN ('stored', 'confirmed') AND place <= ?",
                (own, (newest or 0) - 2 * most),
            )
        db.execute("DELETE FROM key WHERE place <= ?", ((newest or 0) - TOMBSTONES,))

    def confirm(self, session: str, number: int) -> None:
        """The partner holds the same block: its keys may be delivered, its pads used."""
        with self.transaction() as db:
            self._change(db, session, number, "confirmed")
            db.execute(
                "UPDATE pad SET state = 'ready' WHERE origin = ? AND state = 'held'",
                (block_name(session, number),),
            )

    def drop(self, session: str, number: int) -> None:
        """The partner holds another block: erase it here."""
        with self.transaction() as db:
            self._change(db, session, number, "dropped", ", body = NULL, check_ = NULL")
            db.execute(
                "UPDATE pad SET state = 'spent', body = NULL, check_ = NULL "
                "WHERE origin = ? AND state = 'held'",
                (block_name(session, number),),
            )

    @staticmethod
    def _change(
        db: sqlite3.Connection, session: str, number: int, state: State, erase: str = ""
    ) -> None:
        block = "(SELECT place FROM block WHERE session = ? AND number = ?)"
        db.execute(
            f"UPDATE key SET state = ?{erase} WHERE state = 'stored' AND block = {block}",
            (state, session, number),
        )
        db.execute(f"UPDATE block SET state = ? WHERE place = {block}", (state, session, number))

    # --- delivery ---------------------------------------------------------------------------------

    def available(self, share: Share = WHOLE) -> int:
        """Keys of this side's half that are confirmed, not delivered, not refused."""
        if self.refused is not None:
            return 0
        return int(self.rows(f"SELECT COUNT(*) FROM key WHERE {_READY}", _asked(share))[0][0])

    def deliver(self, number: int = 1, who: str = "", share: Share = WHOLE) -> tuple[Key, ...]:
        """The oldest confirmed keys of this side's half, erased here before they are returned.

        Parameters
        ----------
        number : int
            How many; all or none.
        who : str
            Kept in their tombstones.
        share : Share
            Whose keys; all of them where nothing is said.

        Raises
        ------
        TooFewKeys
            When there are not so many.
        KeysRefused
            When nobody gets this store's keys.
        """
        with self.transaction() as db:
            return self.take(db, number, who, share)

    def take(
        self, db: sqlite3.Connection, number: int, who: str, share: Share = WHOLE
    ) -> tuple[Key, ...]:
        """What :meth:`deliver` does, within a transaction that has more to write."""
        self._check_refused()
        rows = db.execute(
            f"SELECT place FROM key WHERE {_READY} ORDER BY place LIMIT ?",
            (*_asked(share), number),
        ).fetchall()
        if len(rows) < number:
            raise TooFewKeys(number, len(rows))
        keys = tuple(self._key(db, place, 1, ("confirmed",)) for (place,) in rows)
        self._bury(db, [place for (place,) in rows], who)
        return keys

    def _key(self, db: sqlite3.Connection, place: int, own: int, states: Sequence[State]) -> Key:
        """The key of a row, as the table has it and not an index."""
        row = db.execute(
            "SELECT state, id, row, own, body, check_ FROM key WHERE place = ?", (place,)
        ).fetchone()
        self.expect(("none", None) if row is None else row[1:], f"the key at place {place}")
        state, name, _, owned, body, _ = row
        if state not in states or owned != own:
            raise StoreError(f"{self.path}: its index does not fit the key at place {place}")
        return Key(name, bytes(body))

    def deliver_named(
        self, ids: Sequence[str], who: str = "", share: Share = WHOLE
    ) -> tuple[Key, ...]:
        """Keys of the partner's half by their ids, erased here before they are returned.

        ``stored`` is enough: whoever knows an id has it from the partner, which gives keys only
        once it has seen that they are stored here.

        Parameters
        ----------
        ids : sequence of str
            All or none; an id that is named twice is one key.
        who : str
            Kept in their tombstones.
        share : Share
            Whose keys; all of them where nothing is said.

        Raises
        ------
        OthersKeys
            When some are of another share.
        UnknownKeys
            When some are not here, were delivered before, or belong to this side's own half.
        KeysRefused
            When nobody gets this store's keys.
        """
        with self.transaction() as db:
            return self.take_named(db, ids, who, share)

    def take_named(
        self, db: sqlite3.Connection, ids: Sequence[str], who: str, share: Share = WHOLE
    ) -> tuple[Key, ...]:
        """What :meth:`deliver_named` does, within a transaction that has more to write."""
        self._check_refused()
        wanted = list(dict.fromkeys(ids))
        found: dict[str, int] = {}
        others = []
        for name in wanted:
            row = db.execute(
                "SELECT place, row FROM key WHERE id = ? AND own = 0 "
                "AND state IN ('stored', 'confirmed')",
                (name,),
            ).fetchone()
            if row is None:
                continue
            found[name] = row[0]
            if not share.has(row[1]):
                others.append(name)
        if others:
            raise OthersKeys(others)
        missing = [name for name in wanted if name not in found]
        if missing:
            raise UnknownKeys(missing)
        keys = tuple(self._key(db, place, 0, ("stored", "confirmed")) for place in found.values())
        if [key.key_id for key in keys] != wanted:
            raise StoreError(f"{self.path}: its index does not fit its keys' ids")
        self._bury(db, [*found.values()], who)
        return keys

    def _check_refused(self) -> None:
        reason = self.refused
        if reason is not None:
            raise KeysRefused(reason)

    def _bury(self, db: sqlite3.Connection, places: Sequence[int], who: str) -> None:
        now = time.time_ns()
        self.gives()
        db.executemany(
            "UPDATE key SET state = 'delivered', body = NULL, check_ = NULL, t_ns = ?, who = ? "
            "WHERE place = ?",
            ((now, who, place) for place in places),
        )

    # --- telling ----------------------------------------------------------------------------------

    def counts(self) -> Counts:
        """How many keys are in which state."""
        rows = self.rows("SELECT state, COUNT(*) FROM key GROUP BY state")
        by = {str(state): int(count) for state, count in rows}
        return Counts(
            by.get("stored", 0),
            by.get("confirmed", 0),
            by.get("delivered", 0),
            by.get("dropped", 0),
            self.available(),
        )

    def blocks(self, last: int | None = None) -> list[BlockRow]:
        """The blocks, oldest first; the ``last`` ones only where that is given."""
        rows = self.rows(
            "SELECT session, number, transitions, steps, counted, rows, keys, state, t_ns "
            "FROM block ORDER BY place DESC LIMIT ?",
            (-1 if last is None else last,),
        )
        return [BlockRow(*row) for row in reversed(rows)]

    def ids(self) -> list[tuple[str, State]]:
        """Every key's id and state, in the order that both ends share."""
        rows = self.rows("SELECT id, state FROM key ORDER BY place")
        return [(name, state) for name, state in rows]

    def own_ids(self) -> list[str]:
        """The ids of this side's half."""
        rows = self.rows("SELECT id FROM key WHERE own = 1 ORDER BY place")
        return [name for (name,) in rows]

    def compare(self) -> dict[str, bytes | None]:
        """Every key by its id, in order, None where it was erased: for whoever holds both stores.

        Nobody else should; a test bed does.
        """
        rows = self.rows("SELECT id, body FROM key ORDER BY place")
        return {name: None if body is None else bytes(body) for name, body in rows}
