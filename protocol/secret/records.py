"""What a key store gives and takes: keys, blocks, counts, and the reasons why not."""

import uuid
from collections.abc import Sequence
from typing import Final, Literal, NamedTuple

NAMESPACE: Final = uuid.UUID("6f1c3f0e-5d4b-5c55-9a61-2b8a4be1a0d7")
"""Namespace of key ids; any fixed one would do."""

Side = Literal["controller", "plant"]
State = Literal["stored", "confirmed", "delivered", "dropped"]


class StoreError(Exception):
    """A store that cannot be used; the text is one line and names the file."""


class KeysRefused(Exception):
    """This store's keys are for nobody; the text says why."""


class TooFewKeys(Exception):
    """Fewer keys are confirmed than were asked for; none was taken."""

    def __init__(self, asked: int, available: int) -> None:
        super().__init__(f"number: got {asked}, expected at most the {available} keys there are")
        self.asked, self.available = asked, available


class Share(NamedTuple):
    """Which keys of a store are one pair's, where several pairs of applications share it.

    Rows 1 and 2 of a block are for the first pair, 3 and 4 for the second, and so on and round
    again: an odd row and an even one, so that either of a pair may be the master.
    """

    place: int = 0
    of: int = 1

    def has(self, row: int) -> bool:
        """Whether a block's row belongs to it."""
        return (row - 1) // 2 % self.of == self.place


WHOLE: Final = Share()


class UnknownKeys(Exception):
    """Some ids are not, or no longer, in this store; none of the others was taken."""

    def __init__(self, ids: Sequence[str]) -> None:
        super().__init__(f"{len(ids)} of the keys asked for are not in this store")
        self.ids = tuple(ids)


class OthersKeys(UnknownKeys):
    """Some ids are of another pair's share; nothing was taken."""


class Key(NamedTuple):
    """A delivered key: its id, a UUID as both ends know it, and its 32 bytes."""

    key_id: str
    key: bytes

    def __repr__(self) -> str:
        return f"Key({self.key_id})"


class BlockRow(NamedTuple):
    """A block as the store remembers it; nothing in it is secret."""

    session: str
    number: int
    transitions: int
    steps: int
    counted: int
    rows: int
    keys: int
    state: str
    t_ns: int


class BlockTag(NamedTuple):
    """Where a block stands, this side's tag of it, and how many keys were made."""

    state: str
    tag: str
    keys: int


class Counts(NamedTuple):
    """Keys by state, both halves together; ``available`` can be delivered from this side's half."""

    stored: int
    confirmed: int
    delivered: int
    dropped: int
    available: int


class PadCounts(NamedTuple):
    """One-time pads of a direction: what went in, what was spent, and what is left."""

    made: int
    spent: int
    left: int


def block_name(session: str, number: int) -> str:
    """The name of a block in ids and ledgers."""
    return f"{session}/{number}"


def key_id(session: str, number: int, row: int) -> str:
    """The id of row ``row`` of a block, the same at both ends."""
    return str(uuid.uuid5(NAMESPACE, f"{block_name(session, number)}/{row}"))
