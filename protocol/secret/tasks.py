"""Tasks for a key maker, and its answers."""

from typing import NamedTuple

from protocol.secret.blocks import BlockResult, ClosedBlock, Stored


class Broken(NamedTuple):
    """The store cannot be used any more. No key is made from here on; the loop goes on."""

    reason: str


Task = ClosedBlock | BlockResult
Done = Stored | BlockResult | Broken
