"""Tasks for a key maker, and its answers."""

from typing import NamedTuple

from protocol.secret.blocks import BlockResult, ClosedBlock, Stored
from protocol.secret.records import Key


class Broken(NamedTuple):
    """The store cannot be used any more. No key is made from here on; the loop goes on."""

    reason: str


class CoinTask(NamedTuple):
    """Keys for the keyed coin of a session are wanted, and others have served.

    The controller sets ``number`` more keys of its half aside; the plant takes those that the
    controller has had it mark. Keys of other sessions are erased, and ``served`` are.
    """

    session: str
    after: str
    """The newest key that is held already; empty: none."""
    number: int = 0
    served: tuple[str, ...] = ()


class CoinKeys(NamedTuple):
    """Keys for the coin, newer than those asked after, in the order in which they serve.

    ``pending``: others are set aside, and the partner has not marked them yet.
    """

    session: str
    keys: tuple[Key, ...] = ()
    pending: bool = False


Task = ClosedBlock | BlockResult | CoinTask
Done = Stored | BlockResult | Broken | CoinKeys
