"""What is asked of a key maker, and what it answers."""

from typing import NamedTuple

from protocol.secret.blocks import BlockResult, ClosedBlock, Stored


class BlockVerdict(NamedTuple):
    """What became of a block, to be written down."""

    session: str
    judgement: BlockResult


class Judged(NamedTuple):
    """A verdict is on disk."""

    session: str
    number: int
    what: str
    keys: int


class Broken(NamedTuple):
    """The store cannot be used any more: no key is made from here on, and the loop goes on."""

    reason: str


Task = ClosedBlock | BlockVerdict
Done = Stored | Judged | Broken
