"""Sessions of the bus come back after a freeze and after a silence; time is an argument."""

import logging
import threading

import pytest

from runtime import link_watchdog
from runtime.bus import TransportError
from runtime.errors import Failure
from runtime.link_watchdog import (
    FROZEN_S,
    LOOK_S,
    SILENT_AT_MOST_S,
    SILENT_S,
    LinkWatchdog,
    watched,
)
from runtime.zenoh_settings import LEASE_MS
from tests.support.patience import PATIENCE_S

LOG = logging.getLogger("test")
PARTNER = ("tcp/127.0.0.1:1", "tcp/127.0.0.1:2")
TAP = ("tcp/127.0.0.1:1", "tcp/127.0.0.1:3")


class Stuck:
    """A bus as the watchdog sees it."""

    def __init__(self) -> None:
        self.received = 0
        self.open: set[tuple[str, str]] = set()
        self.reopened = 0
        self.refuses = False

    def links(self) -> frozenset[tuple[str, str]]:
        return frozenset(self.open)

    def reopen(self) -> None:
        if self.refuses:
            raise TransportError("tcp/127.0.0.1:1: address already in use")
        self.reopened += 1


@pytest.fixture(autouse=True)
def settled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody waits for links to come up."""
    monkeypatch.setattr(link_watchdog, "SETTLE_S", 0.0)


class Watch:
    """A watchdog in virtual time."""

    def __init__(self) -> None:
        self.field, self.management = Stuck(), Stuck()
        self.now = 1000.0
        both = (self.field, self.management)
        self.watchdog = LinkWatchdog(both, LOG, self.field)

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
