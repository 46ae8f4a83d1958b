"""The ledger of one-time pads: what went in, was spent, and is left, beside the keys they guard.

Each direction has pads of its own. A side takes the oldest of its direction that is ``ready``, that
is, whose block the partner has confirmed, and marks it spent before its tag leaves. The partner
tries all that it holds of that direction; so no index travels and none can go out of step. A block
yields one pad for each direction, in its row 0; an aborted one burns a pad and yields none.
"""

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Final

from protocol.secret.authentication import (
    TAG_BYTES,
    Secret,
    SecretError,
    number,
    polynomial,
    read_secret,
    spend_secret,
    under,
)
from protocol.secret.records import PadCounts, Side, StoreError
from protocol.secret.store import KeyStore
from protocol.secret.store_file import UNREADABLE, check_of

SIDES: Final[tuple[Side, Side]] = ("controller", "plant")


class Authentication:
    """Tags of blocks under a secret that both ends share.

    Parameters
    ----------
    store : KeyStore
        Which holds the ledger. The secret must have been taken into it: :func:`take_secret`.
    """

    def __init__(self, store: KeyStore) -> None:
        self._store = store
        point = store.note("point")
        assert point is not None, "no secret was taken into this store"
        self._point = int(point, 16)
        self._own: Side = store.side
        self._partner: Side = SIDES[store.side == "controller"]

    def tag(self, block: str, message: bytes) -> str | None:
        """This side's tag of a block, its pad marked as spent; None when no pad is left.

        Asked again for the same block it gives the same tag.
        """
        with self._store.transaction() as db:
            row = db.execute(
                "SELECT place, side, origin, body, check_ FROM pad WHERE side = ? AND "
                "(used_for = ? OR (state = 'ready' AND used_for IS NULL)) "
                "ORDER BY used_for IS NULL, place LIMIT 1",
                (self._own, block),
            ).fetchone()
            if row is None:
                return None
            place, *pad = row
            self._store.expect(pad, f"pad {place}")
            cursor = db.execute(
                "UPDATE pad SET state = 'spent', used_for = ? "
                "WHERE place = ? AND used_for IS NOT ?",
                (block, place, block),
            )
            if cursor.rowcount:
                self._store.gives()
        return under(number(pad[2]), self._value(self._own, message))

    def accepted(self, block: str, message: bytes) -> dict[str, int]:
        """Every tag that the partner may show for a block, and the number of the pad under it."""
        with self._store.transaction() as db:
            rows = db.execute(
                "SELECT place, side, origin, body, check_ FROM pad WHERE side = ? AND "
                "body IS NOT NULL AND (used_for = ? OR used_for IS NULL) AND origin != ?",
                (self._partner, block, block),
            ).fetchall()
        for place, *pad in rows:
            self._store.expect(pad, f"pad {place}")
        value = self._value(self._partner, message)
        return {under(number(body), value): place for place, _, _, body, _ in rows}

    def spend(self, block: str, pad: int) -> None:
        """The partner has shown a tag under ``pad``: it, and those before, are not taken again."""
        with self._store.transaction() as db:
            db.execute(
                "UPDATE pad SET state = 'spent', used_for = 'passed over' "
                "WHERE side = ? AND used_for IS NULL AND place < ?",
                (self._partner, pad),
            )
            db.execute(
                "UPDATE pad SET state = 'spent', used_for = ? WHERE place = ? AND side = ? AND "
                "used_for IS NULL",
                (block, pad, self._partner),
            )

    def settle(self, block: str) -> None:
        """A block is confirmed for good: the pads that were spent on it are erased."""
        with self._store.transaction() as db:
            db.execute(
                "UPDATE pad SET body = NULL, check_ = NULL "
                "WHERE used_for = ? OR used_for = 'passed over'",
                (block,),
            )

    def _value(self, side: Side, message: bytes) -> int:
        return polynomial(self._point, f"{side}/".encode() + message)


def pads_of(row: bytes) -> tuple[tuple[Side, bytes], tuple[Side, bytes]]:
    """The two pads that a block's row 0 yields."""
    return (SIDES[0], row[:TAG_BYTES]), (SIDES[1], row[TAG_BYTES:])


def pad_counts(path: Path) -> dict[Side, PadCounts]:
    """What the ledger of a key store says of each direction's pads; {} where no secret was taken.

    The file is read beside whoever has it open, and nothing in it is touched.

    Raises
    ------
    StoreError
        When it cannot be read.
    """
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as db:
            rows = db.execute(
                "SELECT side, COUNT(*), SUM(state = 'spent') FROM pad GROUP BY side"
            ).fetchall()
    except UNREADABLE as error:
        raise StoreError(f"{path}: {error}") from None
    return {side: PadCounts(made, spent, made - spent) for side, made, spent in rows}


def take_secret(store: KeyStore, path: Path) -> Authentication:
    """Take the secret of ``path`` into ``store``, once; afterwards the file is only its name.

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
        db.executemany(
            "INSERT OR IGNORE INTO pad VALUES (NULL, ?, ?, 'ready', NULL, ?, ?)",
            (
                (*pad, check_of(*pad))
                for side, pads in zip(SIDES, secret.pads, strict=True)
                for pad in ((side, f"first/{i}", p.to_bytes(TAG_BYTES)) for i, p in enumerate(pads))
            ),
        )
        store.set_note("point", f"{secret.point:032x}")
        store.set_note("secret", secret.name)
