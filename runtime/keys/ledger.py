"""The ledger of one-time pads in a key store: which set of pads signs which key block.

A set is a point and a pad for each direction. The block alone determines its set. So no index
travels, each block has one tag that is accepted, and no set signs two blocks:

- A session's first block that makes keys takes a set of the reserve. Each end asks the other to
  mark the oldest one for that session before either signs, so a set serves one session, whichever
  store is put back.
- Each later block takes the set that the block before it made of its row 0.

A block of :data:`RENEWS` rows or more spends two further rows. One is added to the point of all
later sets, one refills the reserve. An eavesdropper who heard blocks whole and so knows a point
loses it with the first block of which she misses enough.
"""

import json
import sqlite3
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Final, Literal, NamedTuple

from protocol.secret.authentication import PRIME, TAG_BYTES, Secret, number, polynomial, under
from protocol.secret.records import PadCounts, Side, StoreError, block_name
from runtime.keys.secret_file import SecretError, read_secret, spend_secret
from runtime.keys.store import KeyStore
from runtime.keys.store_file import UNREADABLE, check_of

RENEWS: Final = 16
"""Least rows of a block that spends two of them on a fresh point and on the reserve."""

MOST_RESERVE: Final = 32
"""Most sets in the reserve; the oldest beyond them are erased."""

AGREE_S: Final = 10.0
"""Seconds that a session's first block waits for a set that both ends have marked."""

POLL_S: Final = 0.01
"""Seconds between two looks for it."""

Kind = Literal["reserve", "chain"]


class Made(NamedTuple):
    """A set of pads that a block makes: its name, its kind, and its bytes."""

    origin: str
    kind: Kind
    body: bytes


class _Set(NamedTuple):
    origin: str
    point: int
    pads: dict[Side, int]

    def tag(self, side: Side, message: bytes) -> str:
        return under(self.pads[side], polynomial(self.point, f"{side}/".encode() + message))


def spent_rows(rows: int) -> int:
    """Rows of a signed block that make no key: 3, or 1 below :data:`RENEWS` rows."""
    return 3 if rows >= RENEWS else 1


class Authentication:
    """Tags of blocks under a secret that both ends share.

    Parameters
    ----------
    store : KeyStore
        The store that holds the ledger. It must have a secret: :func:`take_secret`.
    wait_s : float
        Seconds to wait for the other end.
    look : callable
        Called between two looks for its answer; sleeps.
    """

    def __init__(
        self,
        store: KeyStore,
        wait_s: float = AGREE_S,
        look: Callable[[], None] = lambda: time.sleep(POLL_S),
    ) -> None:
        assert store.note("secret") is not None, "no secret was taken into this store"
        self._store = store
        self._wait_s = wait_s
        self._look = look
        self._partner: Side = "plant" if store.side == "controller" else "controller"

    def tags(
        self, session: str, block: int, message: bytes, rows: Sequence[bytes]
    ) -> tuple[str, str, str, tuple[Made, ...]] | None:
        """This side's tag of a block, the partner's, the set's name, and the sets that it makes.

        The same block gives the same answer each time. None: no set signs it.
        """
        signing = self._set_of(session, block)
        if signing is None:
            return None
        point, name = signing.point, block_name(session, block)
        made = []
        if len(rows) >= RENEWS:
            point = (point + number(rows[-1][:TAG_BYTES])) % PRIME
            made.append(Made(f"{name}/reserve", "reserve", point.to_bytes(TAG_BYTES) + rows[-2]))
        made.append(Made(name, "chain", point.to_bytes(TAG_BYTES) + rows[0]))
        own = signing.tag(self._store.side, message)
        return own, signing.tag(self._partner, message), signing.origin, tuple(made)

    def origin(self, session: str, block: int) -> str | None:
        """Name of the set that signs a block; None where none can.

        It is the set made by the last block before it that made keys. Blocks too poor for keys are
        passed over at both ends. Any other block without keys leaves the session without a set. So
        does a block that this store does not know: the store was put back, and may have signed
        with that set.
        """
        for before in range(block - 1, -1, -1):
            found = self._store.rows(
                "SELECT state, rows FROM block WHERE session = ? AND number = ?", (session, before)
            )
            if not found:
                return None
            state, rows = found[0]
            if state in ("stored", "confirmed"):
                return block_name(session, before)
            if rows >= 2:
                return None
        found = self._store.rows(
            "SELECT origin FROM pad WHERE session = ? AND kind = 'reserve' "
            "AND state IN ('agreed', 'spent')",
            (session,),
        )
        return str(found[0][0]) if found else self._agree(session)

    def _set_of(self, session: str, block: int) -> _Set | None:
        origin = self.origin(session, block)
        if origin is None:
            return None
        rows = self._store.rows("SELECT origin, body, check_ FROM pad WHERE origin = ?", (origin,))
        if not rows or rows[0][1] is None:
            return None
        self._store.expect(rows[0], f"the pads {origin}")
        body = rows[0][1]
        point, first, second = (
            number(body[at : at + TAG_BYTES]) for at in range(0, len(body), TAG_BYTES)
        )
        return _Set(origin, point, {"controller": first, "plant": second})

    def _agree(self, session: str) -> str | None:
        """Name of a set of the reserve that both ends have marked; None: none left or no answer."""
        until = time.monotonic() + self._wait_s
        self._leave_others(session)
        while True:
            found = self._store.rows(
                "SELECT origin FROM pad WHERE session = ? AND state = 'agreed'", (session,)
            )
            if found:
                return str(found[0][0])
            if not self._asked(session):
                return None
            if time.monotonic() >= until:
                return None
            self._look()

    def _asked(self, session: str) -> bool:
        """Ask for a set unless that was done; False where none is left."""
        with self._store.transaction() as db:
            if db.execute("SELECT 1 FROM asked WHERE use = ?", (session,)).fetchone():
                return True
            agreed = "SELECT 1 FROM pad WHERE session = ? AND state = 'agreed'"
            if db.execute(agreed, (session,)).fetchone():
                return True
            row = db.execute(
                "SELECT origin FROM pad WHERE kind = 'reserve' AND state = 'ready' "
                "ORDER BY place LIMIT 1"
            ).fetchone()
            if row is None:
                return False
            db.execute(
                "UPDATE pad SET state = 'asked', session = ? WHERE origin = ?", (session, *row)
            )
            db.execute("INSERT INTO asked VALUES (?, 'pads', ?, NULL)", (session, json.dumps(row)))
            self._store.gives()
        return True

    def _leave_others(self, session: str) -> None:
        """Erase the sets of former sessions."""
        with self._store.transaction() as db:
            db.execute(
                f"UPDATE pad SET {_SPENT} WHERE body IS NOT NULL AND session IS NOT NULL "
                "AND session != ?",
                (session,),
            )
            db.execute("DELETE FROM asked WHERE what = 'pads' AND use != ?", (session,))

    def confirm(self, session: str, block: int) -> None:
        """Erase the set that signed a block, which is confirmed."""
        origin = self.origin(session, block)
        with self._store.transaction() as db:
            db.execute(f"UPDATE pad SET {_SPENT} WHERE origin = ?", (origin,))
            db.execute(
                f"UPDATE pad SET {_SPENT} WHERE kind = 'reserve' AND state = 'ready' AND place <= "
                "(SELECT place FROM pad WHERE kind = 'reserve' AND state = 'ready' "
                "ORDER BY place DESC LIMIT 1 OFFSET ?)",
                (MOST_RESERVE,),
            )


_SPENT: Final = "state = 'spent', body = NULL, check_ = NULL"


def mark(store: KeyStore, session: str, origins: Sequence[str]) -> tuple[str, ...]:
    """Mark the set under which the partner will sign a session's first block.

    Returns
    -------
    tuple of str
        The set's name where it cannot serve that session; () where it is marked.
    """
    if store.note("secret") is None:
        return tuple(origins)
    with store.transaction() as db:
        (origin,) = origins
        of_session = "kind = 'reserve' AND session = ?"
        bound = db.execute(f"SELECT origin FROM pad WHERE {of_session}", (session,)).fetchone()
        if bound is not None and bound != (origin,):
            return (origin,)
        if bound is not None:  # asked for here as well, or asked for there before
            db.execute(
                f"UPDATE pad SET state = 'agreed' WHERE {of_session} AND state = 'asked'",
                (session,),
            )
            db.execute("DELETE FROM asked WHERE use = ? AND what = 'pads'", (session,))
            return ()
        cursor = db.execute(
            "UPDATE pad SET state = 'agreed', session = ? WHERE origin = ? AND kind = 'reserve' "
            "AND state = 'ready'",
            (session, origin),
        )
        if cursor.rowcount:
            store.gives()
    return () if cursor.rowcount else tuple(origins)


def answered(store: KeyStore, session: str, refused: Sequence[str]) -> int:
    """Note that the partner has marked the set, or erase it where it refuses; returns how many."""
    with store.transaction() as db:
        cursor = db.execute("DELETE FROM asked WHERE use = ? AND what = 'pads'", (session,))
        if cursor.rowcount == 0:
            return 0
        if not refused:
            db.execute(
                "UPDATE pad SET state = 'agreed' WHERE session = ? AND state = 'asked'", (session,)
            )
            return 0
        erased = 0
        for origin in refused:
            erased += db.execute(
                f"UPDATE pad SET {_SPENT}, session = NULL WHERE origin = ? AND state = 'asked'",
                (origin,),
            ).rowcount
    return erased


def ready(store: KeyStore) -> list[str]:
    """Names of the sets of the reserve that may still serve a session, oldest first."""
    rows = store.rows(
        "SELECT origin FROM pad WHERE kind = 'reserve' AND state = 'ready' ORDER BY place"
    )
    return [origin for (origin,) in rows]


def given_before(store: KeyStore, origins: Sequence[str]) -> list[str]:
    """Those of the partner's sets that may have served a session.

    A set that this side does not have is among them, since nobody can use it. Without a secret this
    side knows none.
    """
    if store.note("secret") is None:
        return []
    statement = "SELECT 1 FROM pad WHERE origin = ? AND state IN ('held', 'ready')"
    with store.transaction() as db:
        return [origin for origin in origins if not db.execute(statement, (origin,)).fetchone()]


def were_given(store: KeyStore, origins: Sequence[str]) -> int:
    """Erase sets that served a session, as the partner says; returns how many were erased."""
    with store.transaction() as db:
        return sum(
            db.execute(
                f"UPDATE pad SET {_SPENT} WHERE origin = ? AND state = 'ready'", (origin,)
            ).rowcount
            for origin in origins
        )


def pad_counts(path: Path) -> PadCounts | None:
    """The reserve of the key store at ``path``; None where it has no secret.

    The file may be open elsewhere; nothing is written.

    Raises
    ------
    StoreError
        When it cannot be read.
    """
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as db:
            made, left = db.execute(
                "SELECT COUNT(*), COALESCE(SUM(state IN ('held', 'ready')), 0) FROM pad "
                "WHERE kind = 'reserve'"
            ).fetchone()
    except UNREADABLE as error:
        raise StoreError(f"{path}: {error}") from None
    return PadCounts(made, made - left, left) if made else None


def take_secret(store: KeyStore, path: Path) -> Authentication:
    """Take the secret of ``path`` into ``store``, once. The file then holds only its name.

    Raises
    ------
    SecretError
        When the file holds no secret, or one that another store has taken.
    """
    found, known = read_secret(path), store.note("secret")
    if isinstance(found, str):
        if known != found:
            raise SecretError(
                f"{path}: this secret was taken by another key store; make a new one for both ends"
            )
        return Authentication(store)
    if known not in (None, found.name):
        raise SecretError(
            f"{path}: holds secret {found.name}, but {store.path} was begun with {known}"
        )
    if known is None:
        _fill(store, found)
    spend_secret(path, found.name)
    return Authentication(store)


def _fill(store: KeyStore, secret: Secret) -> None:
    with store.transaction() as db:
        for place, body in enumerate(secret.sets):
            origin = f"first/{place}"
            db.execute(
                "INSERT OR IGNORE INTO pad VALUES (NULL, ?, 'reserve', 'ready', NULL, ?, ?)",
                (origin, body, check_of(origin, body)),
            )
        store.set_note("secret", secret.name)
