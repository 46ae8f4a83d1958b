"""Tasks for a key maker, and its answers."""

from typing import NamedTuple

from protocol.secret.blocks import BlockResult, ClosedBlock, Stored


class BlockVerdict(NamedTuple):
    """A block is confirmed, or differs: the key maker is to write it down."""

    session: str
    judgement: BlockResult


class Judged(NamedTuple):
    """The key maker has written a verdict to disk."""

    session: str
    number: int
    what: str
    keys: int


class Broken(NamedTuple):
    """The store cannot be used any more. No key is made from here on; the loop goes on."""

    reason: str


Task = ClosedBlock | BlockVerdict
Done = Stored | Judged | Broken
