"""Keys that guard messages: set aside by who sends, marked by who hears, bound to their steps here.

A batch is all that is set aside at once; its use is "guard SESSION NUMBER LIFE RANDOM", and its
number is what the messages name: at least the step at which it was set aside, so that a new store
counts on from one that was lost. It serves the process that set it aside, its LIFE, and no later
one: a journal that was put back repeats steps with other states, and no word may serve both. Its
bytes are erased once it has served.
"""

import sqlite3
from typing import Final

from protocol.defence.words import KEY_WORDS, slots
from protocol.secret.records import Key
from protocol.secret.tasks import Batch, GuardKeys, GuardTask
from runtime.keys.giving import new_use
from runtime.keys.store import KeyStore

GUARD: Final = "guard"
"""First word of a use."""

MOST_KEYS_AT_ONCE: Final = 32
"""Keys of a batch at most."""

_ALIVE: Final = "state IN ('stored', 'confirmed')"

_ANY: Final = (f"{GUARD} ", f"{GUARD}!")
"""Uses of this kind are from the first to below the second."""


def serve(store: KeyStore, task: GuardTask) -> GuardKeys:
    """Do what an end asks for its messages.

    Raises
    ------
    StoreError
    """
    uses = f"{GUARD} {task.session} ", f"{GUARD} {task.session}!"
    with store.transaction() as db:
        over = _over(db, task, uses)
        if over:
            store.bury(db, over, GUARD)
        db.execute(
            "DELETE FROM asked WHERE use >= ? AND use < ? AND NOT (use >= ? AND use < ?)",
            (*_ANY, *uses),
        )
        db.execute(
            "UPDATE key SET use = there WHERE there >= ? AND there < ? AND use IS NULL "
            f"AND own = 0 AND {_ALIVE}",
            uses,
        )
        asked = "FROM asked WHERE use >= ? AND use < ? AND refused"
        db.execute(f"DELETE {asked} IS NOT NULL", uses)
        pending = db.execute(f"SELECT 1 {asked} IS NULL LIMIT 1", uses).fetchone() is not None
        sent, begins = [], task.begins
        for number, use, keys in _batches(store, db, uses, own=1):
            if number <= task.sent_after:
                continue
            count = slots(len(keys) * KEY_WORDS, task.session_words, task.step_words)
            first = begins if _instance(use) == task.instance else -count
            begins = max(begins, first + count)
            sent.append(Batch(number, b"".join(key.key for key in keys), first))
        heard = [
            Batch(number, b"".join(key.key for key in keys))
            for number, _, keys in _batches(store, db, uses, own=0)
            if number > task.heard_after
        ]
        promise = _promise(store, task)
        half = (store.available() + 1) // 2  # the others are for other uses
        number = 0 if pending or not task.wants else min(MOST_KEYS_AT_ONCE, half)
        if number:
            newest = max(_next_number(db, uses), task.k)
            use = new_use(GUARD, f"{task.session} {newest:016d} {task.instance}")
            store.set_aside_within(db, use, number)
    return GuardKeys(task.session, tuple(sent), tuple(heard), promise, pending or number > 0)


def _over(db: sqlite3.Connection, task: GuardTask, uses: tuple[str, str]) -> list[str]:
    """Keys of other sessions, and of batches that have served."""
    found: list[str] = []
    for column, taken in (("use", ""), ("there", "AND use IS NULL AND own = 0")):
        rows = db.execute(
            f"SELECT id, own, {column} FROM key WHERE {column} >= ? AND {column} < ? {taken} "
            f"AND {_ALIVE}",
            _ANY,
        )
        for name, own, use in rows:
            since = task.sent_from if own else task.heard_from
            if not uses[0] <= use < uses[1] or _number(use) < since:
                found.append(name)
    return found


def _batches(
    store: KeyStore, db: sqlite3.Connection, uses: tuple[str, str], *, own: int
) -> list[tuple[int, str, tuple[Key, ...]]]:
    """Numbers, uses and keys of the batches of one half that both ends have marked, in order."""
    rows = db.execute(
        f"SELECT use, id FROM key WHERE use >= ? AND use < ? AND own = ? AND {_ALIVE} "
        "AND use NOT IN (SELECT use FROM asked) ORDER BY use, place",
        (*uses, own),
    ).fetchall()
    found: dict[str, list[str]] = {}
    for use, name in rows:
        found.setdefault(use, []).append(name)
    return [
        (_number(use), use, tuple(store.used(db, name, uses) for name in names))
        for use, names in found.items()
    ]


def _promise(store: KeyStore, task: GuardTask) -> tuple[int, int]:
    """What the partner's tags have shown: as the end knows it, or as it was written down."""
    name = f"{GUARD} promise"
    if task.promise[1] >= 0:
        told = f"{task.session} {task.promise[0]} {task.promise[1]}"
        if store.note(name) != told:
            store.set_note(name, told)
        return task.promise
    session, _, steps = (store.note(name) or "").partition(" ")
    if session != task.session:
        return -1, -1
    first, newest = map(int, steps.split())
    return first, newest


def _number(use: str) -> int:
    return int(use.split()[2])


def _instance(use: str) -> str:
    return use.split()[3]


def _next_number(db: sqlite3.Connection, uses: tuple[str, str]) -> int:
    """Number of the session's next batch of this end's half."""
    (newest,) = db.execute(
        "SELECT MAX(use) FROM key WHERE use >= ? AND use < ? AND own = 1", uses
    ).fetchone()
    return 0 if newest is None else _number(newest) + 1
