"""Sessions of the bus come back after a freeze and after a silence; time is an argument."""

import logging
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress

import pytest

from runtime.addresses import free_endpoints
from runtime.bus import ChannelClosed, TransportError
from runtime.errors import Failure
from runtime.link_watchdog import (
    FROZEN_S,
    LOOK_S,
    SILENT_AT_MOST_S,
    SILENT_S,
    LinkWatchdog,
    watched,
)
from runtime.zenoh_bus import ZenohBus
from runtime.zenoh_settings import LEASE_MS
from tests.support.patience import PATIENCE_S

LOG = logging.getLogger("test")
PARTNER = ("tcp/127.0.0.1:1", "tcp/127.0.0.1:2")
TAP = ("tcp/127.0.0.1:1", "tcp/127.0.0.1:3")


class Stuck:
    """A bus as the watchdog sees it."""

    name = "tcp/127.0.0.1:1"

    def __init__(self) -> None:
        self.received = 0
        self.open: set[tuple[str, str]] = set()
        self.reopened = 0
        self.refuses = False

    def links(self) -> frozenset[tuple[str, str]]:
        return frozenset(self.open)

    def reopen(self) -> bool:
        if self.refuses:
            raise TransportError("tcp/127.0.0.1:1: address already in use")
        self.reopened += 1
        return True


class Watch:
    """A watchdog in virtual time."""

    def __init__(self) -> None:
        self.field, self.management = Stuck(), Stuck()
        self.now = 1000.0
        both = (self.field, self.management)
        self.watchdog = LinkWatchdog(both, LOG, self.field, settle=lambda _s: None)

    def passes(self, seconds: float, *, comes_each: float = 0.0) -> list[float]:
        """Let time go by; when sessions were opened again, in seconds from now."""
        began, times = self.now, []
        last = self.now
        while self.now < began + seconds:
            self.now += LOOK_S
            if comes_each and self.now - last >= comes_each:
                self.field.received += 1
                last = self.now
            before = self.field.reopened
            self.watchdog.look(self.now)
            if self.field.reopened > before:
                times.append(self.now - began)
        return times


@pytest.mark.parametrize("frozen_s", [1.5, 20.0, 600.0])
def test_a_process_that_stood_still_opens_all_its_sessions_again(frozen_s: float) -> None:
    """A partner has given it up by then, as far as it can know."""
    watch = Watch()
    watch.field.open.add(PARTNER)
    assert watch.passes(10.0, comes_each=0.1) == []
    watch.now += frozen_s
    (when,) = watch.passes(10.0, comes_each=0.1)
    assert when <= 2 * LOOK_S
    assert watch.management.reopened == 1
    assert FROZEN_S < LEASE_MS / 1000 - 0.5, "a partner's last sign of life may be 0.5 s old"


def test_a_short_pause_opens_nothing() -> None:
    watch = Watch()
    watch.passes(1.0, comes_each=0.1)
    watch.now += FROZEN_S - 2 * LOOK_S
    assert watch.passes(10.0, comes_each=0.1) == []


@pytest.mark.parametrize("frozen_s", [3.0, 60.0, 600.0])
def test_a_link_over_which_nothing_comes_is_given_up(frozen_s: float) -> None:
    """The partner was frozen for so long: it is there again, and its messages do not come."""
    watch = Watch()
    watch.field.open |= {PARTNER, TAP}
    watch.passes(5.0, comes_each=0.1)
    watch.field.open.remove(PARTNER)  # the lease is over; the tap's link stays
    often = watch.passes(frozen_s)
    assert len(often) <= 5 + frozen_s / SILENT_AT_MOST_S, "and seldom, however long it takes"
    watch.field.open.add(PARTNER)
    first = watch.passes(5.0)[0]
    assert first <= SILENT_S + 2 * LOOK_S
    assert watch.management.reopened == watch.field.reopened


def test_who_is_alone_waits_for_ever() -> None:
    watch = Watch()
    assert watch.passes(300.0) == []


def test_a_slow_plant_is_not_silent() -> None:
    """At most one session is opened in vain, until it is known how far apart messages come."""
    watch = Watch()
    watch.field.open.add(PARTNER)
    assert len(watch.passes(300.0, comes_each=10.0)) <= 2


def test_what_cannot_be_opened_again_ends_the_process_in_order() -> None:
    bus = Stuck()
    bus.refuses = True
    bus.open.add(PARTNER)
    stopping = threading.Event()
    with (
        pytest.raises(Failure, match=r"the bus cannot be opened again: .*already in use"),
        watched(stopping, LOG, bus, listens=bus, silent_s=0.0),
    ):
        assert stopping.wait(PATIENCE_S)


KEEP_ALIVE = b"\x01\x00\x04"
"""A batch of Zenoh's over TCP that says no more than that its sender is alive."""


class Splitting:
    """A way between two ends on which a link can be split: it lives, and nothing comes over it."""

    def __init__(self, listens: str, leads: str) -> None:
        self._leads = int(leads.rpartition(":")[2])
        self._socket = socket.create_server(("127.0.0.1", int(listens.rpartition(":")[2])))
        self._deaf: set[tuple[socket.socket, str]] = set()
        self._links: list[socket.socket] = []
        self._threads: list[threading.Thread] = []
        self._start(self._accept)

    def _start(self, target: Callable[..., None], *told: object) -> None:
        thread = threading.Thread(target=target, args=told, daemon=True)
        self._threads.append(thread)
        thread.start()

    def split(self, way: str) -> None:
        """Of what goes ``forth`` or ``back`` over the links of now only signs of life arrive."""
        self._deaf |= {(link, way) for link in self._links}

    def _accept(self) -> None:
        while True:
            try:
                link, _ = self._socket.accept()
            except OSError:
                return
            try:
                onwards = socket.create_connection(("127.0.0.1", self._leads))
            except OSError:
                link.close()
                continue
            self._links += [link, onwards]
            for way, source, sink in (("forth", link, onwards), ("back", onwards, link)):
                self._start(self._carry, link, way, source, sink)

    def _carry(
        self, link: socket.socket, way: str, source: socket.socket, sink: socket.socket
    ) -> None:
        with suppress(OSError), source.makefile("rb") as batches:
            while len(head := batches.read(2)) == 2:
                batch = batches.read(int.from_bytes(head, "little"))
                sink.sendall(KEEP_ALIVE if (link, way) in self._deaf else head + batch)
        for end in (source, sink):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Carry no more."""
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        for link in self._links:
            with suppress(OSError):
                link.shutdown(socket.SHUT_RDWR)
        for thread in self._threads:
            thread.join(PATIENCE_S)
        for link in self._links:
            link.close()


@pytest.mark.slow
@pytest.mark.integration
@pytest.mark.parametrize("deaf", ["listening", "connecting"])
def test_an_end_to_which_nothing_comes_over_a_living_link_hears_again(
    deaf: str, caplog: pytest.LogCaptureFixture
) -> None:
    at, by = free_endpoints(2)
    way = Splitting(by, at)
    with ZenohBus(listen=[at]) as listening, ZenohBus(connect=[by]) as connecting:
        hears, says = (listening, connecting)
        if deaf == "connecting":
            hears, says = says, hears
        channel = hears.channel("wyner/v3/loop/field/offer", 100)
        publisher = says.publisher("wyner/v3/loop/field/offer")
        heard: list[bytes] = []
        over = threading.Event()

        def listen() -> None:
            with suppress(ChannelClosed):
                while True:
                    heard.extend(payload for _, payload in channel.receive(wait=True))

        def say() -> None:
            while not over.wait(0.02):
                publisher.put(b"an offer")

        def hears_again() -> bool:
            heard.clear()
            until = time.monotonic() + PATIENCE_S
            while len(heard) < 20 and time.monotonic() < until:
                time.sleep(0.01)
            return len(heard) >= 20

        threads = [threading.Thread(target=listen), threading.Thread(target=say)]
        for thread in threads:
            thread.start()
        try:
            with watched(over, LOG, hears, listens=hears):
                assert hears_again()
                way.split("forth" if deaf == "listening" else "back")
                time.sleep(0.2)
                assert hears_again()
            assert "nothing has come for" in caplog.text
        finally:
            over.set()
            channel.close()
            for thread in threads:
                thread.join(PATIENCE_S)
            way.close()
