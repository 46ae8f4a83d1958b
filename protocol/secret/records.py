"""What a key store takes and returns: keys, blocks, counts, and its errors."""

import uuid
from collections.abc import Sequence
from typing import Final, Literal, NamedTuple

NAMESPACE: Final = uuid.UUID("6f1c3f0e-5d4b-5c55-9a61-2b8a4be1a0d7")
"""Namespace of key ids; any fixed one would do."""

Side = Literal["controller", "plant"]
State = Literal["stored", "confirmed", "delivered", "dropped"]


class StoreError(Exception):
    """A key store cannot be used. The text is one line and names the file."""


class KeysRefused(Exception):
    """Nobody may have this store's keys. The text says why."""


class TooFewKeys(Exception):
    """Fewer keys are confirmed than were asked for. None was taken."""

    def __init__(self, asked: int, available: int) -> None:
        super().__init__(f"number: got {asked}, expected at most the {available} keys there are")
        self.asked, self.available = asked, available


class Share(NamedTuple):
    """Which keys of a store belong to one pair of applications.

    Rows 1 and 2 of a block are the first pair's, 3 and 4 the second's, and so on and round again.
    Each pair gets odd and even rows, so either of the two may be the master.

    Parameters
    ----------
    place, of : int
        Number of the pair, from 0, and number of pairs.
    """

    place: int = 0
    of: int = 1

    def has(self, row: int) -> bool:
        """Whether row ``row`` (from 1) of a block belongs to the pair."""
        return (row - 1) // 2 % self.of == self.place


WHOLE: Final = Share()


class UnknownKeys(Exception):
    """Some ids are not, or no longer, in this store. No key was taken."""

    def __init__(self, ids: Sequence[str]) -> None:
        super().__init__(f"{len(ids)} of the keys asked for are not in this store")
        self.ids = tuple(ids)


class OthersKeys(UnknownKeys):
    """Some ids belong to another pair. No key was taken."""


class Key(NamedTuple):
    """A delivered key: its id (a UUID, the same at both ends) and its 32 bytes."""

    key_id: str
    key: bytes

    def __repr__(self) -> str:
        return f"Key({self.key_id})"


class BlockRow(NamedTuple):
    """A block as the store records it. Nothing in it is secret."""

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
    """A block's state, this side's tag of it, and the number of its keys."""

    state: str
    tag: str
    keys: int


class Counts(NamedTuple):
    """Number of keys in each state, both halves together.

    ``available`` counts those that this side can deliver from its own half.
    """

    stored: int
    confirmed: int
    delivered: int
    dropped: int
    available: int


def block_name(session: str, number: int) -> str:
    """SESSION/NUMBER, as key ids and ledgers name a block."""
    return f"{session}/{number}"


def key_id(session: str, number: int, row: int) -> str:
    """The id (a UUID) of row ``row`` of a block; the same at both ends."""
    return str(uuid.uuid5(NAMESPACE, f"{block_name(session, number)}/{row}"))
