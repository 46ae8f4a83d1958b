"""From a closed block to stored keys: extract, tag, insert. The loop does not wait for it.

A key maker belongs to one store and keeps no other state. So it can work in a process of its own: a
task that is repeated after a death at any instant gives the same rows, ids and tags.
"""

import time
from pathlib import Path
from typing import Final, NamedTuple

from protocol.secret.blocks import BlockResult, ClosedBlock, Stored
from protocol.secret.records import BlockRow, Side, StoreError
from protocol.secret.tasks import Broken, CoinTask, Done, Task
from runtime.keys import coins
from runtime.keys.store import KeyStore

PUBLIC_TAG_BYTES: Final = 16
"""Bytes of row 0 that are shown to the partner. A chance fault passes with probability 2^-128; a
forger is not kept out."""


class KeyMaker:
    """Makes keys of blocks and stores them.

    Parameters
    ----------
    store : KeyStore
    """

    def __init__(self, store: KeyStore) -> None:
        self.store = store

    def make_keys(self, closed: ClosedBlock) -> Stored:
        """Store a block's keys: rows 1 to R - 1. Row 0 serves the tag.

        A block that began before the store did is stored without keys.
        """
        session, number = closed.session, closed.number
        known = self.store.block_tag(session, number)
        if known is not None and known.state != "stored":
            confirmed = known.state == "confirmed"
            return Stored(session, number, known.tag, confirmed=confirmed, keys=known.keys)
        keys: list[bytes] = []
        tag = ""
        first = closed.last - closed.transitions + 1
        older = known is None and self.store.is_younger(session, number, first)
        if closed.makes_keys and not older:
            from protocol.secret.extractor import extract

            rows = extract(closed.nonces, closed.rows, closed.by_words)
            tag = rows[0][:PUBLIC_TAG_BYTES].hex()
            keys = rows[1:]
        if known is None:
            row = BlockRow(
                session=session,
                number=number,
                transitions=closed.transitions,
                steps=closed.steps,
                counted=closed.counted,
                rows=closed.rows,
                keys=len(keys),
                state="stored" if tag else "empty",
                t_ns=time.time_ns(),
            )
            if not self.store.add(row, keys, tag=tag):  # the partner has just said so
                older, keys, tag = True, [], ""
                self.store.add(row._replace(keys=0, state="empty"), keys)
        return Stored(session, number, tag, keys=len(keys), older=older)

    def judge(self, result: BlockResult) -> BlockResult:
        """Confirm a block, or erase it where the tags differ; the result, with the block's keys."""
        session, number = result.session, result.number
        if result.what == "unequal":
            self.store.drop(session, number)
        else:
            self.store.confirm(session, number)
        row = self.store.block_tag(session, number)
        return result._replace(keys=0 if row is None else row.keys)


def work(key_maker: KeyMaker, task: Task) -> Done:
    """Do one task in the calling thread."""
    try:
        if isinstance(task, ClosedBlock):
            return key_maker.make_keys(task)
        if isinstance(task, CoinTask):
            return coins.serve(key_maker.store, task)
        return key_maker.judge(task)
    except StoreError as error:
        return Broken(str(error))


class KeyMakerAt(NamedTuple):
    """Path and side of a key maker's store."""

    path: Path
    side: Side

    def open(self) -> KeyMaker:
        """Open the store and return its key maker.

        Raises
        ------
        StoreError
            When it cannot be opened.
        """
        return KeyMaker(KeyStore(self.path, self.side))
