"""The key store: one SQLite file a side. A key is confirmed before it is delivered, and once.

A key is ``stored`` when its block has closed here, ``confirmed`` once the partner has shown the
same tag, and ``delivered`` when it was handed out. Its bytes are erased in that same transaction,
before anyone sees them; its row stays. A process that dies in between loses a key, and never gives
one twice. A key is ``dropped`` where its block differed, or nobody fetched it until the store was
full.

The controller hands out odd rows, the plant even ones. The partner finds the same key by its id.
Ids follow from session, block and row, and both ends order alike. A key has the ``use`` that it is
given for here, and the one that it is given for ``there``. The first is set before the partner is
asked, the second before the partner is answered (:mod:`runtime.keys.giving`).

The store is apart from the journal because two processes open it: the service, which adds blocks,
and a key server, which delivers.
"""

import json
import sqlite3
import time
from collections.abc import Sequence
from contextlib import closing
from typing import Final, Literal

from protocol.secret.records import (
    WHOLE,
    BlockRow,
    BlockTag,
    Counts,
    Key,
    KeysRefused,
    OthersKeys,
    Share,
    State,
    StoreError,
    TooFewKeys,
    UnknownKeys,
    block_name,
    key_id,
)
from runtime.keys.store_file import UNREADABLE, StoreFile, check_of

MOST_KEYS: Final = 100_000
"""Newest keys of its own half that a side keeps; older ones are dropped where they were not
delivered. Of the partner's half it keeps twice as many, so it has every key that the partner still
gives out. The halves take turns, so a key's place tells how many are newer."""

TOMBSTONES: Final = 1_000_000
"""Newest keys whose rows are kept at all."""

_BEGUN: Final = "begun"

Held = Literal["unused", "made", "marked"]
"""Keys that may be given: without a known use at the start; the same, made since; and those of the
partner's half that the partner has given."""

_READY: Final = "own = 1 AND state = 'confirmed' AND use IS NULL AND (row - 1) / 2 % ? = ?"
"""Condition: keys of one share of this side's own half that may be delivered."""

_DOUBTFUL: Final = "EXISTS (SELECT 1 FROM doubtful WHERE doubtful.block = key.block)"

_DROPPED: Final = "state = 'dropped', body = NULL, check_ = NULL"


def _pads_of(session: str, number: int) -> tuple[str, str]:
    """Names of the sets of pads that a block makes."""
    name = block_name(session, number)
    return name, f"{name}/reserve"


def _asked(share: Share) -> tuple[int, int]:
    return share.of, share.place


class KeyStore(StoreFile):
    """The keys of one side; opened as a :class:`StoreFile`."""

    @property
    def refused(self) -> str | None:
        """Why nobody gets a key of this store (a seeded run, no claim); None: keys are given."""
        return self.note("refused")

    def refuse(self, reason: str) -> None:
        """Hand out no key of this store from here on, after restarts too."""
        if self.refused is None:
            self.set_note("refused", reason)

    @property
    def assumption(self) -> str:
        """The claim under which the keys are secret, as a sentence."""
        return self.note("assumption") or ""

    def begin(self, session: str | None, transitions: int) -> None:
        """Note once at which transition of which session this store was new."""
        if self.note(_BEGUN) is None:
            self.set_note(_BEGUN, f"{session}/{transitions}")

    def is_younger(self, session: str, number: int, first: int) -> bool:
        """Whether a block that begins at transition ``first`` began before this store did.

        Its keys may have been given, by a store that was removed or by a newer copy of this one.
        """
        if self._is_lost(session, number):
            return True
        begun = self.note(_BEGUN)
        if begun is None:
            return False
        theirs, _, transitions = begun.rpartition("/")
        return theirs == session and first < int(transitions)

    def newest_blocks(self) -> list[str]:
        """Names of the 64 newest blocks, newest first."""
        rows = self.rows("SELECT session, number FROM block ORDER BY place DESC LIMIT 64")
        return [block_name(*row) for row in rows]

    def blocks_beyond(self, names: Sequence[str], most: int) -> list[str]:
        """Blocks that the partner once stored and has lost, as far as this side knows.

        They are newer than ``names``, and were confirmed here or had a key used. Blocks that this
        side has lost are added.

        Parameters
        ----------
        names : sequence of str
            The partner's newest blocks.
        most : int
            Blocks at most, oldest first: the partner can make only those again that follow its
            newest ones.
        """
        with self.transaction() as db:
            place = 0
            for name in names:
                session, _, number = name.rpartition("/")
                if session and number.isdecimal():
                    known = "SELECT place FROM block WHERE session = ? AND number = ?"
                    row = db.execute(known, (session, int(number))).fetchone()
                    place = max(place, 0 if row is None else row[0])
            used = "EXISTS (SELECT 1 FROM key WHERE block = block.place AND "
            used += "(use IS NOT NULL OR there IS NOT NULL OR key.state = 'delivered'))"
            beyond = db.execute(
                "SELECT session, number FROM block WHERE place > ? AND "
                f"(state IN ('confirmed', 'dropped') OR {used}) ORDER BY place LIMIT ?",
                (place, most // 2),
            ).fetchall()
            lost = db.execute(
                "SELECT name FROM lost ORDER BY rowid DESC LIMIT ?", (most // 2,)
            ).fetchall()
        found = [block_name(*row) for row in beyond] + [name for (name,) in lost]
        return [name for name in dict.fromkeys(found) if name not in set(names)]

    def lose(self, names: Sequence[str]) -> None:
        """Make no more keys of these blocks: this side had them before it was put back."""
        with self.transaction() as db:
            db.executemany("INSERT OR IGNORE INTO lost VALUES (?)", ((name,) for name in names))

    def blocks_held(self) -> list[str]:
        """Names of blocks with keys that may still be given."""
        rows = self.rows(
            "SELECT session, number FROM block WHERE place IN (SELECT block FROM key "
            "WHERE state IN ('stored', 'confirmed') AND use IS NULL) ORDER BY place"
        )
        return [block_name(*row) for row in rows]

    def lacking(self, names: Sequence[str]) -> list[str]:
        """Those of these blocks that made no key here, or are not here."""
        with self.transaction() as db:
            rows = db.execute("SELECT session, number FROM block WHERE keys > 0").fetchall()
        known = {block_name(*row) for row in rows}
        return [name for name in names if name not in known]

    def doubt(self, names: Sequence[str]) -> int:
        """Take note that the partner lacks these blocks: it was put back, and may have given keys.

        Keys of confirmed blocks are erased. Other blocks may be about to be made there: they are
        doubtful, and nothing of them is given until the partner confirms them.

        Returns
        -------
        int
            Number of keys that were erased.
        """
        erased = 0
        with self.transaction() as db:
            for name in names:
                session, _, number = name.rpartition("/")
                if not number.isdecimal():
                    continue
                row = db.execute(
                    "SELECT place, state FROM block WHERE session = ? AND number = ?",
                    (session, int(number)),
                ).fetchone()
                if row is not None and row[1] == "confirmed":
                    erased += db.execute(
                        f"UPDATE key SET {_DROPPED} WHERE block = ? AND use IS NULL "
                        "AND state IN ('stored', 'confirmed')",
                        (row[0],),
                    ).rowcount
                elif row is not None:
                    db.execute("INSERT OR IGNORE INTO doubtful VALUES (?)", (row[0],))
        return erased

    def _is_lost(self, session: str, number: int) -> bool:
        return bool(self.rows("SELECT 1 FROM lost WHERE name = ?", (block_name(session, number),)))

    # --- the service's side -----------------------------------------------------------------------

    def add(
        self,
        block: BlockRow,
        keys: Sequence[bytes],
        *,
        tag: str = "",
        pads: Sequence[tuple[str, str, bytes]] = (),
    ) -> bool:
        """Store a block with its keys, rows 1, 2, ...; on return it survives a power failure.

        Ids follow from session, block and row, so a block that is added again is recognised.

        Parameters
        ----------
        block : BlockRow
            Its ``state`` says whether there is anything to confirm.
        keys : sequence of bytes
            32 bytes each.
        tag : str
            This side's tag of the block.
        pads : sequence of (origin, kind, bytes)
            Sets of one-time pads that the block makes, for tags of later blocks.

        Returns
        -------
        bool
            False when the block was there already, or would make keys of a lost one
            (:meth:`lose`). Nothing has changed then.
        """
        with self.transaction() as db:
            if block.state != "empty" and self._is_lost(block.session, block.number):
                return False
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
                "INSERT INTO key (id, block, row, own, state, body, check_) "
                "VALUES (?, ?, ?, ?, 'stored', ?, ?)",
                ((row[0], place, *row[1:], check_of(*row)) for row in rows),
            )
            db.executemany(
                "INSERT OR IGNORE INTO pad VALUES (NULL, ?, ?, 'held', ?, ?, ?)",
                (
                    (
                        origin,
                        kind,
                        block.session if kind == "chain" else None,
                        body,
                        check_of(origin, body),
                    )
                    for origin, kind, body in pads
                ),
            )
            self._make_room(db)
        return True

    def block_tag(self, session: str, number: int) -> BlockTag | None:
        """State, tag and number of keys of a block; None where it is not here."""
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
                f"UPDATE key SET {_DROPPED} WHERE own = ? "
                "AND state IN ('stored', 'confirmed') AND place <= ?",
                (own, (newest or 0) - 2 * most),
            )
        db.execute("DELETE FROM key WHERE place <= ?", ((newest or 0) - TOMBSTONES,))

    def confirm(self, session: str, number: int) -> None:
        """Note that the partner holds the same block: its keys and pads may be used."""
        with self.transaction() as db:
            self._change(db, session, number, "confirmed")
            db.execute(
                "DELETE FROM doubtful WHERE block = "
                "(SELECT place FROM block WHERE session = ? AND number = ?)",
                (session, number),
            )
            db.execute(
                "UPDATE pad SET state = 'ready' WHERE origin IN (?, ?) AND state = 'held'",
                _pads_of(session, number),
            )

    def drop(self, session: str, number: int) -> None:
        """Erase a block: the partner holds another one."""
        with self.transaction() as db:
            self._change(db, session, number, "dropped", ", body = NULL, check_ = NULL")
            db.execute(
                "UPDATE pad SET state = 'spent', body = NULL, check_ = NULL "
                "WHERE origin IN (?, ?) AND state = 'held'",
                _pads_of(session, number),
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
        """Number of keys of this side's half that can be delivered now."""
        if self.refused is not None:
            return 0
        return int(self.rows(f"SELECT COUNT(*) FROM key WHERE {_READY}", _asked(share))[0][0])

    def set_aside(self, use: str, number: int, share: Share = WHOLE) -> tuple[str, ...]:
        """Set the oldest confirmed keys of this side's half aside for a use; returns their ids.

        The partner will be asked to mark them (:mod:`runtime.keys.giving`).

        Raises
        ------
        TooFewKeys
            When there are fewer than ``number``.
        KeysRefused
            When nobody gets this store's keys.
        """
        with self.transaction() as db:
            return self.set_aside_within(db, use, number, share)

    def set_aside_within(
        self, db: sqlite3.Connection, use: str, number: int, share: Share = WHOLE
    ) -> tuple[str, ...]:
        """:meth:`set_aside` within a transaction of the caller."""
        self.check_refused()
        rows = db.execute(
            f"SELECT place, id FROM key WHERE {_READY} ORDER BY place LIMIT ?",
            (*_asked(share), number),
        ).fetchall()
        if len(rows) < number:
            raise TooFewKeys(number, len(rows))
        names = tuple(name for _, name in rows)
        self._ask(db, use, "keys", names)
        db.executemany("UPDATE key SET use = ? WHERE place = ?", ((use, at) for at, _ in rows))
        return names

    def set_aside_named(self, use: str, ids: Sequence[str], share: Share = WHOLE) -> None:
        """Set keys of the partner's half aside for a use, by their ids.

        Keys that are only ``stored`` may be taken: the partner gives an id only once it has seen
        that its key is stored here.

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
            self.check_refused()
            places = []
            missing, others = [], []
            for name in ids:
                row = db.execute(
                    "SELECT place, row FROM key WHERE id = ? AND own = 0 AND use IS NULL "
                    "AND state IN ('stored', 'confirmed')",
                    (name,),
                ).fetchone()
                if row is None:
                    missing.append(name)
                elif not share.has(row[1]):
                    others.append(name)
                else:
                    places.append(row[0])
            if others:
                raise OthersKeys(others)
            if missing:
                raise UnknownKeys(missing)
            self._ask(db, use, "keys", ids)
            db.executemany("UPDATE key SET use = ? WHERE place = ?", ((use, at) for at in places))

    @staticmethod
    def _ask(db: sqlite3.Connection, use: str, what: str, names: Sequence[str]) -> None:
        db.execute(
            "INSERT OR IGNORE INTO asked VALUES (?, ?, ?, NULL)", (use, what, json.dumps(names))
        )

    def answer(self, use: str) -> tuple[str, ...] | None:
        """Names that the partner refuses to mark for a use; None while it has not answered.

        Raises
        ------
        StoreError
            When nothing was asked under that use: the store was put back while in use.
        """
        rows = self.rows("SELECT refused FROM asked WHERE use = ?", (use,))
        if not rows:
            raise StoreError(f"{self.path}: nothing is set aside for {use!r}: was it put back?")
        return None if rows[0][0] is None else tuple(json.loads(rows[0][0]))

    def answered(self, use: str, refused: Sequence[str]) -> int:
        """Take the partner's answer to a request.

        Where it refuses some keys the others are free again. A refused key of this side's half is
        erased: it was given by a newer copy of this store, or the partner does not have it.

        Returns
        -------
        int
            Number of keys that were erased.
        """
        with self.transaction() as db:
            return self.answered_within(db, use, refused)

    @staticmethod
    def answered_within(db: sqlite3.Connection, use: str, refused: Sequence[str]) -> int:
        """:meth:`answered` within a transaction of the caller."""
        cursor = db.execute(
            "UPDATE asked SET refused = ? WHERE use = ? AND refused IS NULL",
            (json.dumps(refused), use),
        )
        if cursor.rowcount == 0 or not refused:
            return 0
        erased = 0
        for name in refused:
            erased += db.execute(
                f"UPDATE key SET {_DROPPED} WHERE id = ? AND use = ? AND own = 1", (name, use)
            ).rowcount
        db.execute("UPDATE key SET use = NULL WHERE use = ? AND state != 'dropped'", (use,))
        return erased

    def forget_uses(self, kind: str) -> None:
        """Forget the uses of a kind that former processes named, and erase their keys."""
        with self.transaction() as db:
            uses = db.execute("SELECT use FROM asked WHERE use LIKE ?", (f"{kind} %",)).fetchall()
            for (use,) in uses:
                db.execute(
                    f"UPDATE key SET {_DROPPED} WHERE use = ? AND state IN ('stored', 'confirmed')",
                    (use,),
                )
                db.execute("DELETE FROM asked WHERE use = ?", (use,))

    def mark(self, use: str, ids: Sequence[str]) -> tuple[str, ...]:
        """Mark these keys for a use of the partner's: all of them, or none.

        A key of the partner's half must be here and unused. A key of this side's half must have
        been given here.

        Returns
        -------
        tuple of str
            Keys that the partner must not give; () where all are marked.
        """
        with self.transaction() as db:
            refused = tuple(name for name in ids if not self._markable(db, use, name))
            if not refused:
                db.executemany(
                    "UPDATE key SET there = ? WHERE id = ?", ((use, name) for name in ids)
                )
        return refused

    @staticmethod
    def _markable(db: sqlite3.Connection, use: str, name: str) -> bool:
        row = db.execute(
            f"SELECT own, state, use, there, {_DOUBTFUL} FROM key WHERE id = ?", (name,)
        ).fetchone()
        if row is None or row[4]:
            return False
        own, state, here, there, _ = row
        if there is not None:
            return bool(there == use)
        if own:
            return here is not None and not here.startswith(("coin ", "guard "))
        return here is None and state in ("stored", "confirmed")

    def newest(self) -> int:
        """The place of the newest key; 0 where there is none."""
        return int(self.rows("SELECT COALESCE(MAX(place), 0) FROM key")[0][0])

    def held(self, after: int, until: int) -> tuple[list[str], list[str]]:
        """Ids of keys that may still be given, of places above ``after`` up to ``until``.

        Returns
        -------
        tuple of two lists
            Keys without a known use, and keys of the partner's half that the partner has given.
        """
        alive = (
            "SELECT id FROM key WHERE place > ? AND place <= ? AND use IS NULL "
            "AND state IN ('stored', 'confirmed')"
        )
        places = after, until
        unused = self.rows(f"{alive} AND there IS NULL ORDER BY place", places)
        marked = self.rows(f"{alive} AND there IS NOT NULL AND own = 0 ORDER BY place", places)
        return [name for (name,) in unused], [name for (name,) in marked]

    def given_before(self, what: Held, ids: Sequence[str]) -> list[str]:
        """Those of the partner's keys that it must not give, since this side knows a use.

        Keys that the partner is about to be asked for are among them: a newer copy of it may have
        been asked. So are, of ``unused`` ones, keys of doubtful blocks (:meth:`doubt`).
        """
        used = "there IS NOT NULL"
        if what != "marked":
            used += " OR use IS NOT NULL OR state IN ('delivered', 'dropped')"
        if what == "unused":
            used += f" OR {_DOUBTFUL}"
        statement = f"SELECT 1 FROM key WHERE id = ? AND ({used})"
        with self.transaction() as db:
            return [name for name in ids if db.execute(statement, (name,)).fetchone()]

    def were_given(self, what: Held, ids: Sequence[str]) -> int:
        """Erase those of these keys without a use here: the partner knows one.

        Returns
        -------
        int
            Number of keys that were erased.
        """
        mark = "there IS NOT NULL" if what == "marked" else "there IS NULL"
        with self.transaction() as db:
            return sum(
                db.execute(
                    f"UPDATE key SET {_DROPPED} WHERE id = ? AND use IS NULL AND {mark} "
                    "AND state IN ('stored', 'confirmed')",
                    (name,),
                ).rowcount
                for name in ids
            )

    def take(self, use: str, who: str = "") -> tuple[Key, ...]:
        """The keys of a use. They are erased here before they are returned.

        Raises
        ------
        StoreError
            When the partner has not marked them, or they are gone.
        """
        with self.transaction() as db:
            return self.take_within(db, use, who)

    def take_within(self, db: sqlite3.Connection, use: str, who: str = "") -> tuple[Key, ...]:
        """:meth:`take` within a transaction of the caller."""
        row = db.execute("SELECT names FROM asked WHERE use = ? AND refused = '[]'", (use,))
        found = row.fetchone()
        if found is None:
            raise StoreError(f"{self.path}: nothing was granted for {use!r}: was it put back?")
        keys = tuple(self._key_of(db, name, "use = ?", use) for name in json.loads(found[0]))
        self.bury(db, [key.key_id for key in keys], who)
        db.execute("DELETE FROM asked WHERE use = ?", (use,))
        return keys

    def used(self, db: sqlite3.Connection, name: str, uses: tuple[str, str]) -> Key:
        """A key that was set aside for a use from the first name to below the second; it stays.

        Raises
        ------
        UnknownKeys
            When it was not.
        """
        return self._key_of(db, name, "use >= ? AND use < ?", *uses)

    def _key_of(self, db: sqlite3.Connection, name: str, usable: str, *values: object) -> Key:
        """The key ``name``, if its row is ``usable``."""
        row = db.execute(
            "SELECT place, id, row, own, body, check_ FROM key "
            f"WHERE id = ? AND state IN ('stored', 'confirmed') AND {usable}",
            (name, *values),
        ).fetchone()
        if row is None:
            raise UnknownKeys((name,))
        self.expect(row[1:], f"the key at place {row[0]}")
        if row[1] != name:
            raise StoreError(f"{self.path}: its index does not fit the key at place {row[0]}")
        return Key(row[1], bytes(row[4]))

    def check_refused(self) -> None:
        """Check that keys of this store may be given.

        Raises
        ------
        KeysRefused
            When nobody gets them.
        """
        reason = self.refused
        if reason is not None:
            raise KeysRefused(reason)

    def bury(self, db: sqlite3.Connection, ids: Sequence[str], who: str) -> None:
        """Erase keys that the transaction under way gives to ``who``."""
        now = time.time_ns()
        self.gives()
        db.executemany(
            "UPDATE key SET state = 'delivered', body = NULL, check_ = NULL, t_ns = ?, who = ? "
            "WHERE id = ?",
            ((now, who, name) for name in ids),
        )

    # --- telling ----------------------------------------------------------------------------------

    def counts(self) -> Counts:
        """Number of keys in each state."""
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
        """The blocks, or the ``last`` newest ones, oldest first."""
        rows = self.rows(
            "SELECT session, number, transitions, steps, counted, rows, keys, state, t_ns "
            "FROM block ORDER BY place DESC LIMIT ?",
            (-1 if last is None else last,),
        )
        return [BlockRow(*row) for row in reversed(rows)]

    def ids(self) -> list[tuple[str, State]]:
        """Id and state of every key, in the order that both ends share."""
        rows = self.rows("SELECT id, state FROM key ORDER BY place")
        return [(name, state) for name, state in rows]

    def own_ids(self) -> list[str]:
        """Ids of this side's half, in order."""
        rows = self.rows("SELECT id FROM key WHERE own = 1 ORDER BY place")
        return [name for (name,) in rows]

    def uses(self) -> dict[str, tuple[str, str]]:
        """For every key the use that it was given for here, and the one marked for the partner."""
        rows = self.rows(
            "SELECT id, CASE state WHEN 'delivered' THEN COALESCE(use, there, '') ELSE '' END, "
            "COALESCE(there, '') FROM key ORDER BY place"
        )
        return {name: (here, there) for name, here, there in rows}

    def same_as(self, partner: "KeyStore") -> bool:
        """Whether both stores hold the same keys: ids, order, and the bytes that are left.

        A run's last block may be stored at one end only; it is confirmed at none. Both stores are
        files, and are compared without loading them.
        """
        self.rows("ATTACH ? AS partner", (str(partner.path),))
        try:
            with self._lock, closing(self.db.cursor()) as shared:
                shared.execute(
                    "SELECT theirs.place, mine.body IS NOT NULL AND theirs.body IS NOT NULL AND "
                    "mine.body != theirs.body FROM main.key AS mine "
                    "CROSS JOIN partner.key AS theirs ON theirs.id = mine.id ORDER BY mine.place"
                )
                last = 0
                for place, differs in shared:
                    if differs or place < last:
                        return False
                    last = place
            kept = "SELECT 1 FROM {}.key AS one WHERE state IN ('confirmed', 'delivered') AND NOT "
            kept += "EXISTS (SELECT 1 FROM {}.key AS other WHERE other.id = one.id) LIMIT 1"
            sides = ("main", "partner"), ("partner", "main")
            return not any(self.rows(kept.format(*both)) for both in sides)
        except UNREADABLE as error:
            raise StoreError(f"{self.path}: {error}") from None
        finally:
            self.rows("DETACH partner")

    def compare(self) -> dict[str, bytes | None]:
        """Every key by its id, in order; None where it was erased. For a holder of both stores."""
        rows = self.rows("SELECT id, body FROM key ORDER BY place")
        return {name: None if body is None else bytes(body) for name, body in rows}
