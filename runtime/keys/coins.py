"""Keys for the keyed coin: set aside, marked by the partner, kept until they have served.

A key is bound to this use before its first digit, at both ends, and no other use can have it then.
Its bytes stay in the store as long as a process that comes after a death may have to go on with
them; they are erased once the key has served. The use of a batch is "coin SESSION NUMBER RANDOM",
so that uses sort as the batches were made.
"""

import sqlite3
from typing import Final

from protocol.secret.records import Key
from protocol.secret.tasks import CoinKeys, CoinTask
from runtime.keys.giving import new_use
from runtime.keys.store import KeyStore

COIN: Final = "coin"
"""First word of a use: the keyed coin of a session, whose id follows."""

_ALIVE: Final = "state IN ('stored', 'confirmed')"

_ANY: Final = (f"{COIN} ", f"{COIN}!")
"""Uses of this kind are from the first to below the second."""


def held(store: KeyStore, session: str | None) -> tuple[Key, ...]:
    """All keys that a session's coin may still need, in order; those of others are erased.

    Raises
    ------
    StoreError
    """
    return serve(store, CoinTask(session or "", "")).keys


def serve(store: KeyStore, task: CoinTask) -> CoinKeys:
    """Do what an end asks for its coin.

    Raises
    ------
    StoreError
    """
    uses = f"{COIN} {task.session} ", f"{COIN} {task.session}!"
    with store.transaction() as db:
        over = _of_other_sessions(db, uses)
        if over or task.served:
            store.bury(db, (*over, *task.served), COIN)
        db.execute(
            "DELETE FROM asked WHERE use >= ? AND use < ? AND NOT (use >= ? AND use < ?)",
            (*_ANY, *uses),
        )
        if store.side == "plant":
            db.execute(
                "UPDATE key SET use = there WHERE there >= ? AND there < ? AND use IS NULL "
                f"AND own = 0 AND {_ALIVE}",
                uses,
            )
            return CoinKeys(task.session, _newer(store, db, uses, task.after))
        asked = "FROM asked WHERE use >= ? AND use < ? AND refused"
        db.execute(f"DELETE {asked} IS NOT NULL", uses)
        pending = db.execute(f"SELECT 1 {asked} IS NULL LIMIT 1", uses).fetchone() is not None
        keys = _newer(store, db, uses, task.after)
        number = 0 if pending else min(task.number, store.available())
        if number:
            use = new_use(COIN, f"{task.session} {_next_batch(db, uses):08d}")
            store.set_aside_within(db, use, number)
    return CoinKeys(task.session, keys, pending or number > 0)


def _of_other_sessions(db: sqlite3.Connection, uses: tuple[str, str]) -> list[str]:
    """Keys of other sessions' coins: those sessions are over."""
    found: list[str] = []
    for column, taken in (("use", ""), ("there", "AND use IS NULL AND own = 0")):
        rows = db.execute(
            f"SELECT id FROM key WHERE {column} >= ? AND {column} < ? {taken} AND {_ALIVE} "
            f"AND NOT ({column} >= ? AND {column} < ?)",
            (*_ANY, *uses),
        )
        found += [name for (name,) in rows]
    return found


def _newer(
    store: KeyStore, db: sqlite3.Connection, uses: tuple[str, str], after: str
) -> tuple[Key, ...]:
    """Keys that the partner has marked for these uses, behind the key ``after``."""
    since: tuple[str, int] | None = "", 0
    if after:
        since = db.execute("SELECT use, place FROM key WHERE id = ?", (after,)).fetchone()
    if since is None:  # forgotten, after a million others: nothing is known to be newer
        return ()
    rows = db.execute(
        f"SELECT id FROM key WHERE use >= ? AND use < ? AND (use, place) > (?, ?) AND {_ALIVE} "
        "AND use NOT IN (SELECT use FROM asked) ORDER BY use, place",
        (*uses, *since),
    ).fetchall()
    return tuple(store.used(db, name, uses) for (name,) in rows)


def _next_batch(db: sqlite3.Connection, uses: tuple[str, str]) -> int:
    """Number of the session's next batch."""
    (newest,) = db.execute("SELECT MAX(use) FROM key WHERE use >= ? AND use < ?", uses).fetchone()
    return 0 if newest is None else int(newest.split()[2]) + 1
