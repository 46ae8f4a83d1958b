"""The interface of a bus; :mod:`runtime.zenoh_bus` implements it."""

from collections.abc import Callable
from types import TracebackType
from typing import Protocol, Self

from runtime.errors import UsageError

Deliver = Callable[[str, bytes, int], None]
"""Takes key, payload and t_ns: the publisher's time stamp in nanoseconds since 1970.

It runs on the transport's own thread, which carries every other message too, so it may only put
what it got on a queue. Time stamps order messages of one publisher, and an answer never comes
before what it answers; where clocks disagree the two may carry the same nanosecond.
"""


class TransportError(UsageError):
    """The bus cannot be used; the text is one line that names the endpoint, key or file."""


class Publisher(Protocol):
    """Puts payloads on one key."""

    def put(self, payload: bytes) -> None:
        """Send ``payload``. It is lost without an error when nobody listens or a queue is full."""


class ChannelClosed(Exception):
    """Nothing comes from this channel any more."""


class BusChannel(Protocol):
    """Messages of others that wait to be taken by one thread; the newest push out the oldest."""

    def receive(self, *, wait: bool) -> list[tuple[str, bytes]]:
        """All that wait, oldest first, each after its key; with ``wait`` there is at least one.

        Raises
        ------
        ChannelClosed
            When the channel or its bus has been closed.
        """

    def close(self) -> None:
        """End the subscription; whoever waits is woken."""


class Bus(Protocol):
    """Publish and subscribe, on which the session rules build.

    A put never waits: it is lost where nobody listens, a queue is full or a link dies. One
    publisher's messages arrive in order or not at all, and under their own key or not at all. A bus
    never delivers its own messages to itself. Peers relay nothing: each pair needs one that listens
    and one that connects, in any order.
    """

    def publisher(self, key: str, *, many: bool = False) -> Publisher:
        """A publisher on one key (no wildcard); one of ``many`` may wait 1 ms for others."""

    def subscribe(self, key_expr: str, deliver: Deliver, *, patient: bool = False) -> None:
        """Call ``deliver`` with every message of others that fits, until the bus is closed.

        ``patient``: they may gather for some milliseconds, which spares the processor.
        """

    def channel(self, key_expr: str, capacity: int) -> BusChannel:
        """The messages of others that fit, for a thread that waits for them."""

    def appearances(self) -> int:
        """How often a message that is put now leaves, as far as this end can know; 1 at least.

        On a medium each link to another machine, and each multicast group, is one time. Within the
        machine nothing is on a medium: each link but the partner's is one, for it is a tap's.
        """

    def taken(self, key: str, payload: bytes) -> None:  # noqa: ARG002
        """A message off a channel is handled now."""
        return

    def left(self, loop: str) -> None:  # noqa: ARG002
        """A loop has left: drop what is kept of its messages."""
        return

    def close(self) -> None:
        """End all subscriptions and publishers; closing twice is allowed."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


Note = Callable[[str, bytes], None]
"""Takes key and payload of a message that passes."""


class Overheard(Bus):
    """A bus of which every message that is put is noted before it passes, and every one handled.

    Parameters
    ----------
    bus : Bus
        Closed by whoever opened it.
    put : callable
        Notes what leaves.
    taken : callable, optional
        Notes what came over a channel, when it is handled.
    """

    def __init__(self, bus: Bus, put: Note, taken: Note | None = None) -> None:
        self._bus, self._noted_put, self._noted_taken = bus, put, taken or bus.taken

    def publisher(self, key: str, *, many: bool = False) -> Publisher:
        """A publisher on one key."""
        return _NotedPublisher(self._bus.publisher(key, many=many), key, self._noted_put)

    def channel(self, key_expr: str, capacity: int) -> BusChannel:
        """The messages of others that fit."""
        return self._bus.channel(key_expr, capacity)

    def subscribe(self, key_expr: str, deliver: Deliver, *, patient: bool = False) -> None:
        """As the bus does."""
        self._bus.subscribe(key_expr, deliver, patient=patient)

    def taken(self, key: str, payload: bytes) -> None:
        """Note it."""
        self._noted_taken(key, payload)

    def appearances(self) -> int:
        """As the bus does."""
        return self._bus.appearances()

    def left(self, loop: str) -> None:
        """As the bus does."""
        self._bus.left(loop)

    def close(self) -> None:
        """As the bus does."""
        self._bus.close()


class _NotedPublisher:
    def __init__(self, publisher: Publisher, key: str, note: Note) -> None:
        self._put, self._key, self._note = publisher.put, key, note

    def put(self, payload: bytes) -> None:
        self._note(self._key, payload)
        self._put(payload)
