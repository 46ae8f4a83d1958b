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


class Batch(NamedTuple):
    """Keys that guard messages, set aside at once.

    Parameters
    ----------
    number : int
        Of the session's batches of that direction, from 0.
    key : bytes
        All of them in order.
    first : int
        The step that it begins with, at the end that sends; -1 at the other one.
    """

    number: int
    key: bytes
    first: int = -1

    def __repr__(self) -> str:
        return f"Batch({self.number}, from step {self.first})"


class GuardTask(NamedTuple):
    """Keys that guard a session's messages are wanted, and others have served.

    An end guards what it sends with keys of its own half, and opens what it hears with the
    partner's. Keys of other sessions are erased, and those of batches below ``sent_from`` and
    ``heard_from``.
    """

    session: str
    instance: str
    """Random id of the process: what another has set aside serves no message of this one."""
    k: int
    """The step."""
    begins: int
    """The first step that a new batch may begin with."""
    session_words: int = 0
    step_words: int = 0
    """Words of key that a batch takes once, and for each message; none: it sends none guarded."""
    sent_after: int = -1
    heard_after: int = -1
    """The newest batches that are held already."""
    sent_from: int = 0
    heard_from: int = 0
    wants: bool = False
    """Whether another batch is to be set aside."""
    promise: tuple[int, int] = (-1, -1)
    """What the partner's tags have shown (:class:`protocol.link.guard.Promise`); written down."""


class GuardKeys(NamedTuple):
    """Batches that this end sends under, and those that it hears under, newer than asked after.

    ``pending``: others are set aside, and the partner has not marked them yet.
    """

    session: str
    sent: tuple[Batch, ...] = ()
    heard: tuple[Batch, ...] = ()
    promise: tuple[int, int] = (-1, -1)
    pending: bool = False


Task = ClosedBlock | BlockResult | CoinTask | GuardTask
Done = Stored | BlockResult | Broken | CoinKeys | GuardKeys
