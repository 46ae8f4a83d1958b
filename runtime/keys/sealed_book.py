"""Sealed messages, in the file of the keys that they use.

At the controller a message is ``queued``; ``asked`` (its keys are set aside, and the plant is asked
to mark them); ``sealed`` (keys and text are erased, the ciphertext kept); and ``done`` once the
plant has acknowledged it, or ``lost`` where the plant cannot open it. At the plant one transaction
keeps the text and erases the keys. So a process may die at any instant and a store may be put back:
no key seals twice, no message opens twice, and none that was accepted is lost without a word.
"""

import hashlib
import json
from collections.abc import Sequence
from typing import Final, Literal, NamedTuple

from protocol.secret.records import KeysRefused, TooFewKeys
from protocol.secret.sealed import Unsealed, keys_needed, seal, unseal
from runtime.keys.giving import SEALED, new_use
from runtime.keys.store import KeyStore

SealState = Literal["queued", "asked", "sealed", "done", "lost"]

MOST_TRIES: Final = 16
"""Wrong tags that a plant checks under the keys of one message before it gives the keys up. A
forger succeeds with probability 16 (words + 1) / (2^127 - 1) at most."""


_OPEN: Final = "state NOT IN ('done', 'lost')"


class SealedText(NamedTuple):
    """A sealed message as it travels."""

    identifier: str
    key_ids: tuple[str, ...]
    cipher: bytes
    tag: str

    def header(self) -> bytes:
        """What the tag covers beside the ciphertext: id and key ids, in one encoding."""
        return json.dumps(["wyner sealed", self.identifier, *self.key_ids]).encode()


class SealedBook:
    """The sealed messages of one side.

    Parameters
    ----------
    store : KeyStore
        The store in whose file they stand.
    """

    def __init__(self, store: KeyStore) -> None:
        self.store = store

    # --- the controller's -------------------------------------------------------------------------

    def queue(self, identifier: str, payload: bytes) -> SealState:
        """Queue a message, once an identifier; returns its state.

        Raises
        ------
        KeysRefused
            When this store's keys are for nobody.
        ValueError
            When the identifier belongs to another message.
        """
        if self.store.refused is not None:
            raise KeysRefused(self.store.refused)
        digest = hashlib.sha256(payload).digest()
        with self.store.transaction() as db:
            db.execute(
                "INSERT OR IGNORE INTO sealed (id, digest, state, payload) "
                "VALUES (?, ?, 'queued', ?)",
                (identifier, digest, payload),
            )
            found, state = db.execute(
                "SELECT digest, state FROM sealed WHERE id = ?", (identifier,)
            ).fetchone()
        if found != digest:
            raise ValueError(f"id: {identifier!r} is another message's")
        answer: SealState = state
        return answer

    def waiting(self) -> int:
        """Number of messages that the plant has not acknowledged."""
        with self.store.transaction() as db:
            row = db.execute(f"SELECT COUNT(*) FROM sealed WHERE {_OPEN}").fetchone()
        return int(row[0])

    def next(self) -> SealedText | None:
        """The oldest open message, if it is sealed. Where it is queued, set its keys aside.

        None: there is no message, there are too few keys, or the plant has not marked them.

        Raises
        ------
        KeysRefused
            When this store's keys are for nobody.
        """
        with self.store.transaction() as db:
            row = db.execute(
                "SELECT number, id, state, payload, key_ids, cipher, tag FROM sealed "
                f"WHERE {_OPEN} ORDER BY number LIMIT 1"
            ).fetchone()
            if row is None:
                return None
            number, identifier, state, payload, key_ids, cipher, tag = row
            if state == "sealed":
                return SealedText(identifier, tuple(json.loads(key_ids)), cipher, tag)
            if state == "asked":
                return None
            use = new_use(SEALED, identifier)
            try:
                names = self.store.set_aside_within(db, use, keys_needed(len(payload)))
            except TooFewKeys:
                return None
            db.execute(
                "UPDATE sealed SET state = 'asked', key_ids = ?, use = ? WHERE number = ?",
                (json.dumps(names), use, number),
            )
        return None

    def answered(self, use: str, refused: Sequence[str]) -> int:
        """Take the plant's answer: seal the use's message under its marked keys.

        Keys that the plant refuses are erased, and the message waits for others.

        Returns
        -------
        int
            Number of keys that were erased.
        """
        with self.store.transaction() as db:
            row = db.execute(
                "SELECT number, id, payload FROM sealed WHERE use = ? AND state = 'asked'", (use,)
            ).fetchone()
            if row is None:  # of a key server
                return self.store.answered_within(db, use, refused)
            number, identifier, payload = row
            erased = self.store.answered_within(db, use, refused)
            if refused:
                db.execute("DELETE FROM asked WHERE use = ?", (use,))
                db.execute(
                    "UPDATE sealed SET state = 'queued', key_ids = NULL, use = NULL "
                    "WHERE number = ?",
                    (number,),
                )
                return erased
            keys = self.store.take_within(db, use, f"{SEALED} {identifier}")
            blank = SealedText(identifier, tuple(key.key_id for key in keys), b"", "")
            cipher, tag = seal(blank.header(), payload, [key.key for key in keys])
            db.execute(
                "UPDATE sealed SET state = 'sealed', payload = NULL, key_ids = ?, cipher = ?, "
                "tag = ? WHERE number = ?",
                (json.dumps(blank.key_ids), cipher, tag, number),
            )
        return 0

    def acknowledged(self, identifier: str) -> bool:
        """Note that the plant has opened the message; True the first time."""
        with self.store.transaction() as db:
            cursor = db.execute(
                "UPDATE sealed SET state = 'done' WHERE id = ? AND state = 'sealed'",
                (identifier,),
            )
        return cursor.rowcount == 1

    def give_up(self, identifier: str, key_ids: Sequence[str]) -> bool:
        """Give up a message that the plant cannot open; True the first time.

        Its text is gone, so its sender must send it again.
        """
        with self.store.transaction() as db:
            cursor = db.execute(
                "UPDATE sealed SET state = 'lost' WHERE id = ? AND state = 'sealed' "
                "AND key_ids = ?",
                (identifier, json.dumps(tuple(key_ids))),
            )
        return cursor.rowcount == 1

    def sent(self) -> list[tuple[SealedText, bytes]]:
        """Every message that was sealed here, in order, with the SHA-256 of its text."""
        with self.store.transaction() as db:
            rows = db.execute(
                "SELECT id, key_ids, cipher, tag, digest FROM sealed WHERE cipher IS NOT NULL "
                "ORDER BY number"
            ).fetchall()
        return [
            (SealedText(name, tuple(json.loads(key_ids)), cipher, tag), digest)
            for name, key_ids, cipher, tag, digest in rows
        ]

    # --- the plant's ------------------------------------------------------------------------------

    def open(self, text: SealedText) -> bool:
        """Open a message and keep its text; True the first time.

        Raises
        ------
        Unsealed
            When it was changed on its way. Its keys stay for the true one, up to
            :data:`MOST_TRIES` times.
        UnknownKeys
            When its keys are not here, not marked for it, or given up.
        KeysRefused
            When this store's keys are for nobody.
        """
        try:
            with self.store.transaction() as db:
                known = "SELECT 1 FROM opened WHERE id = ?"
                if db.execute(known, (text.identifier,)).fetchone():
                    return False
                keys = self.store.marked(db, SEALED, text.identifier, text.key_ids, MOST_TRIES)
                payload = unseal(text.header(), text.cipher, text.tag, [key.key for key in keys])
                self.store.bury(db, text.key_ids, f"{SEALED} {text.identifier}")
                db.execute(
                    "INSERT INTO opened (id, payload) VALUES (?, ?)", (text.identifier, payload)
                )
        except Unsealed as error:
            if self.store.tried(text.key_ids) == MOST_TRIES:
                raise Unsealed(f"{error}, {MOST_TRIES} times: its keys are given up") from None
            raise
        return True

    def opened(self) -> list[tuple[str, bytes]]:
        """Identifier and text of every message that was opened here, in order."""
        with self.store.transaction() as db:
            rows = db.execute("SELECT id, payload FROM opened ORDER BY number").fetchall()
        return [(identifier, bytes(payload)) for identifier, payload in rows]
