"""Sealed messages beside the keys they use, in one file: taken and written in one transaction.

At the controller a message is ``queued``, then ``sealed`` (its keys are erased, its text too, the
ciphertext kept), then ``done`` once the plant has acknowledged it. At the plant the text is kept
and its keys are erased in the same transaction. So a process may die at any instant: nothing is
sealed twice under one key, nothing is opened twice, and nothing that was accepted is lost.
"""

import hashlib
import json
from typing import Literal, NamedTuple

from protocol.secret.records import KeysRefused, TooFewKeys
from protocol.secret.sealed import keys_needed, seal, unseal
from protocol.secret.store import KeyStore

SealState = Literal["queued", "sealed", "done"]


class SealedText(NamedTuple):
    """A sealed message as it travels."""

    identifier: str
    key_ids: tuple[str, ...]
    cipher: bytes
    tag: str

    def header(self) -> bytes:
        """What is tagged beside the ciphertext."""
        return json.dumps(["wyner sealed", self.identifier, *self.key_ids]).encode()


class SealedBook:
    """The sealed messages of one side.

    Parameters
    ----------
    store : KeyStore
        In whose file they stand.
    """

    def __init__(self, store: KeyStore) -> None:
        self.store = store

    # --- the controller's -------------------------------------------------------------------------

    def queue(self, identifier: str, payload: bytes) -> SealState:
        """Take in a message once; returns where it stands.

        Raises
        ------
        KeysRefused
            When this store's keys are for nobody.
        ValueError
            When the identifier is another message's.
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
        """Messages that the plant has not acknowledged."""
        with self.store.transaction() as db:
            row = db.execute("SELECT COUNT(*) FROM sealed WHERE state != 'done'").fetchone()
        return int(row[0])

    def next(self) -> SealedText | None:
        """The message to send now: the oldest, sealed if it is not yet; None without enough keys.

        Raises
        ------
        KeysRefused
            When this store's keys are for nobody.
        """
        try:
            with self.store.transaction() as db:
                row = db.execute(
                    "SELECT number, id, state, payload, key_ids, cipher, tag FROM sealed "
                    "WHERE state != 'done' ORDER BY number LIMIT 1"
                ).fetchone()
                if row is None:
                    return None
                number, identifier, state, payload, key_ids, cipher, tag = row
                if state == "sealed":
                    return SealedText(identifier, tuple(json.loads(key_ids)), cipher, tag)
                keys = self.store.take(db, keys_needed(len(payload)), f"sealed {identifier}")
                blank = SealedText(identifier, tuple(key.key_id for key in keys), b"", "")
                cipher, tag = seal(blank.header(), payload, [key.key for key in keys])
                db.execute(
                    "UPDATE sealed SET state = 'sealed', payload = NULL, key_ids = ?, cipher = ?, "
                    "tag = ? WHERE number = ?",
                    (json.dumps(blank.key_ids), cipher, tag, number),
                )
        except TooFewKeys:
            return None
        return blank._replace(cipher=cipher, tag=tag)

    def acknowledged(self, identifier: str) -> bool:
        """The plant has it; True the first time."""
        with self.store.transaction() as db:
            cursor = db.execute(
                "UPDATE sealed SET state = 'done' WHERE id = ? AND state = 'sealed'",
                (identifier,),
            )
        return cursor.rowcount == 1

    def sent(self) -> list[tuple[SealedText, bytes]]:
        """Every message that was sealed here, in order, with the SHA-256 of its text."""
        with self.store.transaction() as db:
            rows = db.execute(
                "SELECT id, key_ids, cipher, tag, digest FROM sealed WHERE state != 'queued' "
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
            When it was changed on its way; its keys stay for the true one.
        UnknownKeys
            When its keys are not here.
        KeysRefused
            When this store's keys are for nobody.
        """
        with self.store.transaction() as db:
            if db.execute("SELECT 1 FROM opened WHERE id = ?", (text.identifier,)).fetchone():
                return False
            keys = self.store.take_named(db, text.key_ids, f"sealed {text.identifier}")
            payload = unseal(text.header(), text.cipher, text.tag, [key.key for key in keys])
            db.execute("INSERT INTO opened (id, payload) VALUES (?, ?)", (text.identifier, payload))
        return True

    def opened(self) -> list[tuple[str, bytes]]:
        """Every message that was opened here, in order: its identifier and its text."""
        with self.store.transaction() as db:
            rows = db.execute("SELECT id, payload FROM opened ORDER BY number").fetchall()
        return [(identifier, bytes(payload)) for identifier, payload in rows]
