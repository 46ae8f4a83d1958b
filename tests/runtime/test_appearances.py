"""How often a message leaves: counted from links, before anybody can hear it by them."""

import threading
import time

import pytest

from runtime.addresses import appearances, free_endpoints, is_group
from runtime.bus import TransportError
from runtime.host import Sparing
from runtime.zenoh_bus import ZenohBus
from tests.support.patience import wait_for

HOME, AWAY, OTHER = "tcp/127.0.0.1:1", "udp/192.0.2.1:1", "udp/192.0.2.2:1"


@pytest.mark.parametrize(
    ("links", "groups", "routed", "count"),
    [
        ([], 0, False, 1),
        ([(HOME, HOME)], 0, False, 1),  # the partner
        ([(HOME, HOME)] * 2, 0, False, 1),  # and a tap
        ([(HOME, HOME)] * 3, 0, False, 2),  # and two
        ([(AWAY, AWAY)] * 2, 0, False, 1),  # this machine by its own address
        ([("tcp/[::1]:1", "tcp/[::1]:2")] * 3, 0, False, 2),
        ([(AWAY, OTHER)], 0, False, 1),
        ([(AWAY, OTHER)] * 2, 0, False, 2),
        ([(AWAY, OTHER), (HOME, HOME)], 0, False, 2),
        ([], 1, False, 1),
        ([(AWAY, OTHER)], 1, False, 2),
        ([(AWAY, OTHER)], 0, True, 2),
        ([(HOME, HOME)], 0, True, 1),
    ],
)
def test_links_beyond_the_machine_count_each_and_within_it_the_taps(
    links: list[tuple[str, str]], groups: int, routed: bool, count: int
) -> None:
    assert appearances(links, groups, routed=routed) == count


@pytest.mark.parametrize(
    ("endpoint", "group"),
    [
        ("udp/224.0.0.251:7461#iface=eth0", True),
        ("udp/[ff02::1]:7461", True),
        ("udp/192.0.2.1:7461", False),
        ("udp/plant.field:7461", False),
        ("tcp/224.0.0.251:7461", False),
    ],
)
def test_what_a_multicast_group_is(endpoint: str, group: bool) -> None:
    assert is_group(endpoint) == group


def test_a_group_is_listened_on() -> None:
    with pytest.raises(TransportError, match="multicast group: expected it to be listened on"):
        ZenohBus(connect=["udp/224.0.0.251:7461"])


def test_a_message_is_not_sent_once_there_are_more_links_than_it_was_made_for() -> None:
    sent: list[bytes] = []

    class Publisher:
        def put(self, payload: bytes) -> None:
            sent.append(payload)

    crowding = False
    sparing = Sparing(Publisher(), lambda: crowding)
    sparing.put(b"one")
    crowding = True
    sparing.put(b"two")
    assert sent == [b"one"]


@pytest.mark.integration
@pytest.mark.parametrize("protocol", ["tcp", "udp"])
def test_a_link_is_counted_before_the_first_message_leaves_by_it(protocol: str) -> None:
    (free,) = free_endpoints(1)
    endpoint = f"{protocol}/{free.removeprefix('tcp/')}"
    heard: list[list[int]] = [[], [], []]
    with ZenohBus(listen=[endpoint]) as here:
        put = here.publisher("a/b").put
        over = threading.Event()

        def speak() -> None:
            while not over.is_set():
                began = time.monotonic()
                said = b"%d" % here.appearances()
                if time.monotonic() - began < 0.0005:  # else others ran meanwhile, and it is old
                    put(said)
                time.sleep(0.0002)

        speaker = threading.Thread(target=speak)
        speaker.start()
        try:
            others = []
            for mine in heard:
                others.append(ZenohBus(connect=[endpoint]))
                others[-1].subscribe("a/b", lambda _k, body, _t, m=mine: m.append(int(body)))  # type: ignore[misc]
                wait_for(lambda m=mine: m)  # type: ignore[misc]
        finally:
            over.set()
            speaker.join()
        assert [mine[0] for mine in heard] == [1, 1, 2]  # all on this machine: one is the partner's
        for other in others:
            other.close()
        wait_for(lambda: here.appearances() == 1)
