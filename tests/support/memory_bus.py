"""The bus that carries messages within one process, with faults where asked: for tests."""

import re
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from runtime.bus import Bus, ChannelClosed, Deliver, TransportError

Fault = Callable[[str, bytes], Sequence[bytes]]
"""Takes key and payload; answers what arrives: nothing, the payload, several, another one."""


class MemoryHub:
    """The wire between `MemoryBus` objects of one process.

    Parameters
    ----------
    fault : callable, optional
        Asked once for each put; what it returns is delivered in its place.
    """

    def __init__(self, fault: Fault | None = None) -> None:
        self.fault = fault
        self._lock = threading.Lock()
        self._subscriptions: list[tuple[MemoryBus, re.Pattern[str], Deliver]] = []
        self._last_ns = 0

    def add(self, bus: "MemoryBus", key_expr: str, deliver: Deliver) -> None:
        """Subscribe ``bus``."""
        with self._lock:
            self._subscriptions.append((bus, _pattern(key_expr), deliver))

    def remove(self, bus: "MemoryBus") -> None:
        """End all subscriptions of ``bus``."""
        with self._lock:
            self._subscriptions = [one for one in self._subscriptions if one[0] is not bus]

    def listeners(self, bus: "MemoryBus", key: str) -> list[Deliver]:
        """Who hears what ``bus`` puts on ``key``."""
        with self._lock:
            return [
                deliver
                for owner, pattern, deliver in self._subscriptions
                if owner is not bus and pattern.fullmatch("/" + key)
            ]

    def put(self, bus: "MemoryBus", key: str, payload: bytes) -> None:
        """Deliver at once, in the caller's thread, with strictly increasing time stamps."""
        for arriving in (payload,) if self.fault is None else self.fault(key, payload):
            with self._lock:
                self._last_ns = t_ns = max(time.time_ns(), self._last_ns + 1)
            for deliver in self.listeners(bus, key):
                deliver(key, arriving, t_ns)


@dataclass(frozen=True, slots=True)
class MemoryPublisher:
    """A `Publisher` on a hub."""

    bus: "MemoryBus"
    key: str

    def put(self, payload: bytes) -> None:
        """Deliver ``payload`` to everyone else before returning."""
        self.bus.put(self.key, payload)


class MemoryChannel:
    """A `BusChannel` on a hub."""

    def __init__(self, capacity: int) -> None:
        self._waiting: deque[tuple[str, bytes]] = deque(maxlen=capacity)
        self._changed = threading.Condition()
        self._closed = False

    def deliver(self, key: str, payload: bytes, _t_ns: int) -> None:
        """Put a message in; the oldest makes room for it."""
        with self._changed:
            self._waiting.append((key, payload))
            self._changed.notify()

    def receive(self, *, wait: bool) -> list[tuple[str, bytes]]:
        """All that wait; with ``wait`` at least one."""
        with self._changed:
            while wait and not self._waiting and not self._closed:
                self._changed.wait()
            if self._closed:
                raise ChannelClosed
            taken = list(self._waiting)
            self._waiting.clear()
            return taken

    def close(self) -> None:
        """Wake whoever waits; nothing comes any more."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()


class MemoryBus(Bus):
    """A `Bus` within the process. In key expressions ``*`` fits a chunk and ``**`` any chunks."""

    def __init__(self, hub: MemoryHub) -> None:
        self.hub = hub
        self._closed = False
        self._channels: list[MemoryChannel] = []

    def publisher(self, key: str, *, many: bool = False) -> MemoryPublisher:
        """A publisher on one key; every message goes at once."""
        if "*" in key:
            raise TransportError(f"key {key!r}: expected a key without wildcards")
        return MemoryPublisher(self, key)

    def put(self, key: str, payload: bytes) -> None:
        """Deliver ``payload`` to everyone else; nothing happens once the bus is closed."""
        if not self._closed:
            self.hub.put(self, key, payload)

    def subscribe(self, key_expr: str, deliver: Deliver, *, patient: bool = False) -> None:
        """Call ``deliver`` in the publishing thread with every message of others that fits."""
        self.hub.add(self, key_expr, deliver)

    def channel(self, key_expr: str, capacity: int) -> MemoryChannel:
        """The messages of others that fit, for a thread that waits for them."""
        channel = MemoryChannel(capacity)
        self._channels.append(channel)
        self.hub.add(self, key_expr, channel.deliver)
        return channel

    def appearances(self) -> int:
        """Once: nothing leaves the process."""
        return 1

    def close(self) -> None:
        """End all subscriptions."""
        self._closed = True
        self.hub.remove(self)
        for channel in self._channels:
            channel.close()


_WILD: Final = {"*": r"/[^/]+", "**": r"(?:/[^/]+)*"}


def _pattern(key_expr: str) -> re.Pattern[str]:
    chunks = key_expr.split("/")
    if any(not chunk or ("*" in chunk and chunk not in _WILD) for chunk in chunks):
        raise TransportError(f"key {key_expr!r}: expected a key, or chunks of it as * or **")
    # Each chunk but ** brings the slash before it, so that a/** fits a as well.
    parts = [_WILD.get(chunk, "/" + re.escape(chunk)) for chunk in chunks]
    return re.compile("".join(parts))
