"""The bus that carries messages between processes, over Zenoh.

This is the only file that imports zenoh, and it does so when a bus is opened: importing it stays
cheap, and a process that has opened none can fork.
"""

import json
import os
import re
import secrets
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from math import inf
from threading import get_ident
from typing import TYPE_CHECKING, Any, Final

from runtime.addresses import Addresses, TlsFiles, appearances, check_endpoint, is_group
from runtime.bus import Bus, ChannelClosed, Deliver, TransportError
from runtime.hanging import within
from runtime.zenoh_settings import ONE_THREAD, settings_of

if TYPE_CHECKING:
    import zenoh

LARGEST_MESSAGE: Final = 2**18
"""Bytes of a message at most: three times the longest message to deliver, in base64."""

SHOWN: Final = 64
"""Bytes of a longer one that are delivered."""

NAP_S: Final = 0.01
"""A nap of a patient subscriber; the kernel's buffer of a connection holds what comes meanwhile."""

YOUNG_NS: Final = 1_000_000
"""Nanoseconds above the youngest age up to which a message counts as not kept waiting."""

AGES: Final = 4096
"""Messages after which the smallest age expires; it holds for one or two such spans."""

CLOSE_S: Final = 2.0
"""Seconds that closing waits: Zenoh waits for partners that are frozen, and has waited for ever."""

REOPEN_S: Final = 20.0
"""Seconds in which a session must be open again."""

AGAIN_S: Final = 0.1
"""Seconds between two attempts to open it."""

SESSION_S: Final = 0.5
"""Seconds between two looks of a waiting channel at whether its bus has been closed."""

_JSON: Final = "application/json"


class _Nap:
    """Says when a patient subscriber may nap: messages are as young as the youngest of late.

    The smallest age expires after :data:`AGES` messages: a clock that was set makes later ages
    larger.
    """

    def __init__(self) -> None:
        self._smallest_ns = 1 << 62
        self._before_ns = 1 << 62
        self._looked = 0

    def due(self, age_ns: int) -> bool:
        """Whether a receiver of a message of this age is up to date."""
        self._looked += 1
        if self._looked % AGES == 0:
            self._before_ns, self._smallest_ns = self._smallest_ns, age_ns
        self._smallest_ns = min(self._smallest_ns, age_ns)
        return age_ns - min(self._smallest_ns, self._before_ns) <= YOUNG_NS


class ZenohPublisher:
    """A `Publisher` over Zenoh: it drops rather than blocks.

    One of ``many`` is not declared. Zenoh searches a message's matches among all keys that the
    receiver has declared, each time: with 400 of them a message cost its receiver 78
    microseconds of processor time, with one 18. A put to an undeclared key costs 9 more.
    """

    def __init__(self, bus: "ZenohBus", key: str, *, many: bool) -> None:
        import zenoh

        # Every message names its key a second time: see `ZenohBus.subscribe`.
        self._settings: dict[str, Any] = {
            "encoding": zenoh.Encoding(f"{_JSON};{key}"),
            # BLOCK held a put for 5 s while a partner was frozen.
            "congestion_control": zenoh.CongestionControl.DROP,
            "express": not many,
            "allowed_destination": zenoh.Locality.REMOTE,
        }
        self._bus = bus
        self._key = key
        self._many = many
        self._session: zenoh.Session | None = None
        self._put: Callable[[bytes], object] = self._lost
        self._refused = zenoh.ZError

    def attach(self, session: "zenoh.Session") -> None:
        """Publish on this session from now on."""
        import zenoh

        self._session = session
        if self._many:
            self._put = partial(session.put, zenoh.KeyExpr(self._key), **self._settings)
        else:
            self._put = session.declare_publisher(self._key, **self._settings).put

    def detach(self) -> None:
        """Publish nowhere until it is attached again."""
        self._put = self._lost
        self._session = None

    @property
    def matched(self) -> bool:
        """Whether somebody listens to the key at this moment; what is put before is gone."""
        if self._session is None:
            return False
        status: Any = self._session.declare_publisher(self._key).matching_status  # no bool
        return bool(status.matching)

    def _lost(self, _payload: bytes) -> None:
        """There is no session now; where there will be one the message is as lost as any other."""
        if self._bus.closed:
            raise TransportError(f"key {self._key}: the bus is closed")

    def put(self, payload: bytes) -> None:
        """Send ``payload`` to whoever is connected and ready; it never waits.

        Raises
        ------
        TransportError
            When the bus has been closed.
        """
        try:
            self._put(payload)
        except self._refused as error:
            if self._bus.closed:
                raise TransportError(f"key {self._key}: {_reason(error)}") from None


class ZenohChannel:
    """A `BusChannel` over Zenoh: the waiting thread is woken by the transport, and nobody else."""

    def __init__(self, bus: "ZenohBus", key_expr: str, capacity: int) -> None:
        import zenoh

        self._bus = bus
        self._key = key_expr
        self._capacity = capacity
        self._encoding = f"{_JSON};{key_expr}"
        self._subscriber: Any = None
        self._handler: Any = None
        self._closed = False
        self._attached = threading.Event()
        self._ended = zenoh.ZError

    def attach(self, session: "zenoh.Session") -> None:
        """Take messages from this session from now on."""
        import zenoh

        self._subscriber = session.declare_subscriber(
            self._bus.spelling(self._key),
            zenoh.handlers.RingChannel(self._capacity),
            allowed_origin=zenoh.Locality.REMOTE,
        )
        self._handler = self._subscriber.handler
        self._attached.set()

    def detach(self) -> Any:
        """Its session ends; returns what is to be undeclared, which wakes the thread that waits."""
        self._attached.clear()
        subscriber, self._subscriber = self._subscriber, None
        return subscriber

    def receive(self, *, wait: bool) -> list[tuple[str, bytes]]:
        """All that wait; with ``wait`` at least one, or an empty list where that one was dropped.

        Raises
        ------
        ChannelClosed
            When the channel or its bus has been closed.
        """
        taken: list[tuple[str, bytes]] = []
        try:
            sample = self._handler.recv() if wait else self._handler.try_recv()
            while sample is not None:
                self._bus.received += 1
                if str(sample.encoding) == self._encoding:  # of a wildcard it never is
                    taken.append((self._key, _bounded(sample)))
                elif _named_alike(sample, key := str(sample.key_expr)):
                    taken.append((key, _bounded(sample)))
                sample = self._handler.try_recv()
        except self._ended:
            if not taken:
                self._await_session(wait=wait)
        return taken

    def _await_session(self, *, wait: bool) -> None:
        """The session has ended: wait for the next one.

        Raises
        ------
        ChannelClosed
            When there will be none.
        """
        while not (self._closed or self._bus.closed):
            if self._attached.wait(SESSION_S) or not wait:
                return
        raise ChannelClosed

    def close(self) -> None:
        """End the subscription, within :data:`CLOSE_S`."""
        self._closed = True
        self._bus.end(self)


class _Subscription:
    """Messages that a callback takes, from one session after the other."""

    def __init__(self, bus: "ZenohBus", key_expr: str, receive: "Callable[[zenoh.Sample], None]"):
        self._bus = bus
        self._key_expr = key_expr
        self._receive = receive

    def attach(self, session: "zenoh.Session") -> None:
        """Take messages from this session from now on."""
        import zenoh

        session.declare_subscriber(
            self._bus.spelling(self._key_expr),
            zenoh.handlers.Callback(self._receive, indirect=False),
            allowed_origin=zenoh.Locality.REMOTE,
        )

    def detach(self) -> None:
        """Its session ends, and the subscription with it."""


def _keep_thread_state() -> None:
    """Have Python keep what it needs to run in this thread of Zenoh's, until the thread ends.

    It would make it anew at each call, 16 KiB that are mapped, touched and unmapped: a quarter of
    all that a tap of 60 loops did.
    """
    import ctypes

    ctypes.pythonapi.PyGILState_Ensure()  # never released: the state has one user for good


def _bounded(sample: "zenoh.Sample") -> bytes:
    """The payload; of one that is too long its size and its first bytes, which is malformed."""
    size = len(sample.payload)
    payload = sample.payload.to_bytes()
    return payload if size <= LARGEST_MESSAGE else b"%d bytes: " % size + payload[:SHOWN]


def _named_alike(sample: "zenoh.Sample", key: str) -> bool:
    """Whether the encoding names the key that the sample came under, or none."""
    encoding, _, named = str(sample.encoding).partition(";")
    return encoding != _JSON or named in ("", key)


class ZenohBus(Bus):
    """A `Bus` over one Zenoh session; opened by the constructor.

    Peers talk only to peers they are connected with (nothing is relayed), so every pair needs one
    side that listens and one that connects. A peer opens at once and looks for its partners in
    the background for as long as it lives: services start in any order. A client waits here until
    a router answers.

    Parameters
    ----------
    listen, connect : sequence of str
        Endpoints, ``tcp/HOST:PORT`` or, with ``tls``, ``tls/HOST:PORT``.
    client : bool
        Talk through the router at ``connect`` only.
    tls : TlsFiles, optional
        Mutual TLS: both sides show a certificate of the same authority.
    patience_s : float
        How long a client waits for its router.
    extra : mapping, optional
        More Zenoh configuration, key to JSON value; wins over what is set here.

    Attributes
    ----------
    closed : bool
    received : int
        Messages that have come.

    Raises
    ------
    TransportError
        When an endpoint is malformed, in use or cannot be opened, or no router answered in time.
    """

    def __init__(
        self,
        *,
        listen: Sequence[str] = (),
        connect: Sequence[str] = (),
        client: bool = False,
        tls: TlsFiles | None = None,
        patience_s: float = inf,
        extra: Mapping[str, Any] | None = None,
    ) -> None:
        if client and (listen or not connect):
            raise TransportError("client: expected endpoints to connect to, and none to listen on")
        for option, given in (("listen", listen), ("connect", connect)):
            for endpoint in given:
                check_endpoint(endpoint, option, tls=tls is not None)
        for endpoint in filter(is_group, connect):
            raise TransportError(f"{endpoint}: a multicast group: expected it to be listened on")
        import zenoh

        self._refused = zenoh.ZError
        self._client = client
        self._groups = sum(map(is_group, listen))
        self._endpoints = (*listen, *connect)
        addresses = Addresses(tuple(listen), tuple(connect), client, tls)
        self._settings = settings_of(addresses) | dict(extra or {})
        self._parts: list[ZenohPublisher | ZenohChannel | _Subscription] = []
        self._changing = threading.Lock()
        self.closed = False
        self.received = 0
        until = time.monotonic() + patience_s if client else -inf
        self._session = _open(self._settings, self._endpoints, retry_until=until)
        self._links: list[zenoh.Link] | None = None  # as they were counted last
        self._appearances = 1

    def links(self) -> frozenset[tuple[str, str]]:
        """The links that are open, by their two locators; a multicast group's are to each other."""
        try:
            return frozenset((x.src, x.dst) for x in self._session.info.links())
        except self._refused:  # closed
            return frozenset()

    def spelling(self, key_expr: str) -> str:
        """``key_expr``, in a multicast group as no other session there spells it.

        Zenoh 1.10 says a subscription again to the group each time that another session says the
        same one. Two that have it in common answer each other for ever, with 8,000 frames a second,
        and of five hardly a message gets through. An empty wildcard in places that are drawn
        changes the name, and nothing that it fits.
        """
        if not self._groups:
            return key_expr
        return "/".join(
            chunk if "*" in chunk else "".join(one + secrets.choice(("", "$*")) for one in chunk)
            for chunk in key_expr.split("/")
        )

    def appearances(self) -> int:
        """How often a message that is put now leaves, by the links that are open; 1 at least.

        A link counts whether or not its other side asks for the message: that is not known. Nor are
        retransmissions of TCP's, and what a router does beyond sending a message on once. Zenoh is
        asked each time (2 microseconds): its events of links come up to 25 ms after the first
        message that has left by a link.
        """
        try:
            links = self._session.info.links()
        except self._refused:  # closed
            return self._appearances
        if links != self._links:
            self._links = links
            pairs = [(link.src, link.dst) for link in links if link.group is None]
            self._appearances = appearances(pairs, self._groups, routed=self._client)
        return self._appearances

    def _attach(self, part: "ZenohPublisher | ZenohChannel | _Subscription", key: str) -> None:
        """Put a part on the session, and on each one that takes its place."""
        try:
            with self._changing:
                part.attach(self._session)
                self._parts.append(part)
        except self._refused as error:
            raise TransportError(f"key {key!r}: {_reason(error)}") from None

    def end(self, channel: ZenohChannel) -> None:
        """End a channel alone, within :data:`CLOSE_S`."""

        def undeclare() -> None:
            with self._changing:
                if channel in self._parts:
                    self._parts.remove(channel)
                    self._undeclare([channel.detach()])

        within(CLOSE_S, undeclare)

    def _undeclare(self, subscribers: "Sequence[Any]") -> None:
        for subscriber in subscribers:
            if subscriber is not None:
                with suppress(self._refused):
                    subscriber.undeclare()

    def publisher(self, key: str, *, many: bool = False) -> ZenohPublisher:
        """A publisher on one key: congestion control DROP, remote subscribers only.

        Raises
        ------
        TransportError
            When ``key`` is no key.
        """
        publisher = ZenohPublisher(self, key, many=many)
        self._attach(publisher, key)
        return publisher

    def subscribe(self, key_expr: str, deliver: Deliver, *, patient: bool = False) -> None:
        """Call ``deliver`` on Zenoh's thread with every message of others that fits.

        Of a message beyond `LARGEST_MESSAGE` its size and its first bytes are delivered: malformed,
        which whoever gets it counts.

        A ``patient`` one naps there as soon as it is up to date: the kernel keeps what comes
        meanwhile, and one wake takes dozens of messages. Whether it is up to date it knows from
        the age of a message, which is as small as any before: so it never naps while it is behind.

        A message whose encoding names another key than the one it came under is dropped. Peers
        agree on numbers for keys, and where one of them was frozen and the other has connected
        anew, Zenoh 1.10 now and then reads a number as it was before.

        Raises
        ------
        TransportError
            When ``key_expr`` is no key expression.
        """
        nap = _Nap()
        threads: set[int] = set()

        def receive(sample: "zenoh.Sample") -> None:
            if (thread := get_ident()) not in threads:
                threads.add(thread)
                _keep_thread_state()
            self.received += 1
            key = str(sample.key_expr)
            if not _named_alike(sample, key):
                return
            stamp = sample.timestamp
            t_ns = time.time_ns() if stamp is None else stamp.get_time_as_ntp64().as_nanos()
            deliver(key, _bounded(sample), t_ns)
            if patient and nap.due(time.time_ns() - t_ns):
                time.sleep(NAP_S)

        self._attach(_Subscription(self, key_expr, receive), key_expr)

    def channel(self, key_expr: str, capacity: int) -> ZenohChannel:
        """The messages of others that fit, on a ring of Zenoh's own; keys are checked as ever.

        Raises
        ------
        TransportError
            When ``key_expr`` is no key expression.
        """
        channel = ZenohChannel(self, key_expr, capacity)
        self._attach(channel, key_expr)
        return channel

    def reopen(self) -> None:
        """End the session and open another in its place, with all that is on it.

        It is another peer to all others, so that nothing is left of what they knew of the one
        before. It waits until that can be: for the port, or for a client's router. Messages are
        lost meanwhile.

        Raises
        ------
        TransportError
            When it cannot be within :data:`REOPEN_S`, as where the session before does not end.
        """
        with self._changing:
            if not within(CLOSE_S, self._detach()):
                where = ", ".join(self._endpoints)
                raise TransportError(f"{where}: the session does not end: start this again")
            within(CLOSE_S, partial(_close_session, self._session))
            until = time.monotonic() + REOPEN_S
            while not self.closed:
                try:
                    session = _open(self._settings, self._endpoints, retry_until=-inf)
                except TransportError:
                    if time.monotonic() > until and not self._client:
                        raise
                    time.sleep(AGAIN_S)
                    continue
                self._session = session
                for part in self._parts:
                    part.attach(session)
                return

    def _detach(self) -> Callable[[], None]:
        """Take every part off the session; what is left to be done wakes the threads that wait."""
        subscribers: list[Any] = [part.detach() for part in self._parts]
        return partial(self._undeclare, subscribers)

    def close(self) -> None:
        """Close the session, within :data:`CLOSE_S`; closing twice is allowed.

        An attempt to connect that is under way can hold this up for 1 s. Where the session does not
        close it is left, and the process ends all the same (:func:`runtime.hanging.leave`).
        """
        self.closed = True

        def close() -> None:
            with self._changing:
                self._detach()()
                _close_session(self._session)

        within(CLOSE_S, close)


def _close_session(session: Any) -> None:  # its stub leaves close() untyped
    import zenoh

    with suppress(zenoh.ZError):  # after ten seconds it says that it takes too long
        session.close()


def open_bus(endpoints: Addresses, patience_s: float = inf) -> ZenohBus:
    """Open the bus that ``endpoints`` describe; a client waits so long for its router.

    Raises
    ------
    TransportError
        As :class:`ZenohBus` does.
    """
    return ZenohBus(
        listen=endpoints.listen,
        connect=endpoints.connect,
        client=endpoints.client,
        tls=endpoints.tls,
        patience_s=patience_s,
    )


def open_router(
    listen: Sequence[str],
    tls: TlsFiles | None = None,
    access_control: Mapping[str, Any] | None = None,
) -> ZenohBus:
    """Open a Zenoh router for clients; it relays until it is closed.

    Parameters
    ----------
    listen : sequence of str
        Endpoints.
    tls : TlsFiles, optional
        Mutual TLS; without it nobody can be told apart by certificate.
    access_control : mapping, optional
        Zenoh's table ``access_control``.

    Raises
    ------
    TransportError
        As :class:`ZenohBus` does.
    """
    extra: dict[str, Any] = {"mode": "router"}
    if access_control is not None:
        extra["access_control"] = dict(access_control)
    return ZenohBus(listen=listen, tls=tls, extra=extra)


def _open(
    settings: Mapping[str, Any], endpoints: Sequence[str], *, retry_until: float
) -> "zenoh.Session":
    import zenoh

    if settings["mode"] != "router":  # which has the messages of many to relay
        os.environ.setdefault("ZENOH_RUNTIME", ONE_THREAD)  # read when the first session opens
    config = zenoh.Config()
    for key, value in settings.items():
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError as error:
            raise TransportError(f"zenoh setting {key}: {_reason(error)}") from None
    while True:
        try:
            return zenoh.open(config)
        except zenoh.ZError as error:
            if time.monotonic() < retry_until and "Unable to connect" in str(error):
                continue
            named = [one for one in endpoints if one.partition("#")[0] in str(error)]
            where = ", ".join(named or endpoints) or "zenoh"
            raise TransportError(f"{where}: cannot be opened: {_reason(error)}") from None


def _reason(error: Exception) -> str:
    """The cause in Zenoh's message, without its source locations."""
    text = " ".join(str(error).split())
    system = re.search(r"([A-Z][^:\[\]]*) \(os error \d+\)", text)
    if system:
        return system[1].lower()
    return re.split(r" at \S+\.rs:\d+", text)[0].rstrip(". ")
