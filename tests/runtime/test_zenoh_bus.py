"""The transport: the in-memory bus, and real Zenoh on free loopback ports."""

import json
import os
import queue
import signal
import subprocess
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest

from runtime.addresses import Addresses, TlsFiles, check_endpoint, free_endpoints
from runtime.bus import Bus, ChannelClosed, TransportError
from runtime.zenoh_bus import (
    CLOSE_S,
    LARGEST_MESSAGE,
    ZenohBus,
    ZenohPublisher,
    open_bus,
    open_router,
)
from tests.support.memory_bus import MemoryBus, MemoryHub
from tests.support.patience import PATIENCE_S, wait_for
from tests.support.programs import started

KEY = "wyner/v2/loop/offer"


class Inbox:
    """Keeps what a subscription delivers."""

    def __init__(self, bus: Bus, key_expr: str = "wyner/v2/loop/**") -> None:
        self.queue: queue.SimpleQueue[tuple[str, bytes, int]] = queue.SimpleQueue()
        bus.subscribe(key_expr, lambda *message: self.queue.put(message))

    def take(self) -> tuple[str, bytes, int]:
        return self.queue.get(timeout=PATIENCE_S)

    def payloads(self) -> list[bytes]:
        return [self.queue.get_nowait()[1] for _ in range(self.queue.qsize())]


def send_until_heard(bus: Bus, inbox: Inbox, key: str = KEY) -> None:
    """Put until the newest message comes out: the way is open, and nothing is left on it."""
    publisher = bus.publisher(key)
    end = time.monotonic() + PATIENCE_S
    attempt = 0
    while time.monotonic() < end:
        attempt += 1
        publisher.put(b"hello %d" % attempt)
        with suppress(queue.Empty):
            while inbox.queue.get(timeout=0.05)[1] != b"hello %d" % attempt:
                pass
            return
    raise AssertionError(f"not within {PATIENCE_S} s: a message on {key}")


# --- endpoints -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "endpoint",
    [
        "",
        "foo",
        "tcp",
        "tcp/host",
        "quic/127.0.0.1:7",
        "tcp/127.0.0.1:65536",
        "tcp/a b:1",
        "tcp/:1",
    ],
)
def test_a_malformed_endpoint_is_one_line_that_names_it(endpoint: str) -> None:
    for arguments in ({"listen": [endpoint]}, {"connect": [endpoint]}):
        with pytest.raises(TransportError) as caught:
            ZenohBus(**arguments)  # type: ignore[arg-type]
        assert repr(endpoint) in str(caught.value)
        assert "tcp/HOST:PORT" in str(caught.value)
        assert "\n" not in str(caught.value)


def test_names_and_ipv6_addresses_are_endpoints() -> None:
    for endpoint in ("tcp/controller:7447", "tcp/[::1]:7447", "tcp/0.0.0.0:7447#iface=eth0"):
        assert check_endpoint(endpoint) == endpoint
    with pytest.raises(TransportError, match="expected tls/HOST:PORT"):
        check_endpoint("tcp/controller:7447", tls=True)


def test_missing_certificates_are_named(tmp_path: Path) -> None:
    (tmp_path / "ca.pem").write_text("")
    with pytest.raises(TransportError, match=r"cert\.pem: no such file"):
        TlsFiles.in_folder(tmp_path)
    (tmp_path / "cert.pem").write_text("")
    (tmp_path / "key.pem").write_text("")
    assert TlsFiles.in_folder(tmp_path).key == tmp_path / "key.pem"


# --- memory --------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["memory", "zenoh"])
def test_a_channel_gives_what_waits_and_ends_when_it_is_closed(kind: str) -> None:
    hub = MemoryHub()
    (endpoint,) = free_endpoints(1)
    with (
        MemoryBus(hub) if kind == "memory" else ZenohBus(listen=[endpoint]) as source,
        MemoryBus(hub) if kind == "memory" else ZenohBus(connect=[endpoint]) as sink,
    ):
        channel = sink.channel("wyner/v2/*/offer", 4)
        publisher = source.publisher("wyner/v2/b/offer", many=True)
        wait_for(lambda: not isinstance(publisher, ZenohPublisher) or publisher.matched)
        taken: list[tuple[str, bytes]] = []
        ended = threading.Event()

        def take() -> None:
            with suppress(ChannelClosed):
                while True:
                    taken.extend(channel.receive(wait=True))
            ended.set()

        publisher.put(b"0")
        thread = threading.Thread(target=take)
        thread.start()
        wait_for(lambda: len(taken) == 1)
        publisher.put(b"1")
        wait_for(lambda: len(taken) == 2)
        channel.close()
        assert ended.wait(PATIENCE_S)
        thread.join()
    assert taken == [("wyner/v2/b/offer", b"0"), ("wyner/v2/b/offer", b"1")]


# --- Zenoh ---------------------------------------------------------------------------------------


@pytest.mark.integration
def test_zenoh_carries_messages_both_ways_in_order_and_never_back_to_the_sender() -> None:
    endpoints = free_endpoints(1)
    with (
        open_bus(Addresses(listen=tuple(endpoints))) as plant,
        open_bus(Addresses(connect=tuple(endpoints))) as controller,
    ):
        at_plant, at_controller = Inbox(plant), Inbox(controller)
        send_until_heard(plant, at_controller, "wyner/v2/loop/measurement")
        send_until_heard(controller, at_plant)
        publisher = plant.publisher("wyner/v2/loop/measurement")
        before = time.time_ns()
        messages = []
        for i in range(0, 200, 4):  # lock-step with four at once: no queue on the way fills up
            for j in range(4):
                publisher.put(b"%d" % (i + j))
            messages += [at_controller.take() for _ in range(4)]
        assert [payload for _, payload, _ in messages] == [b"%d" % i for i in range(200)]
        assert {key for key, _, _ in messages} == {"wyner/v2/loop/measurement"}
        stamps = [t_ns for _, _, t_ns in messages]
        assert stamps == sorted(stamps)
        # The stamp is the publisher's, taken at the put: here both sides share one clock.
        assert before - 1e6 < stamps[0] <= stamps[-1] < time.time_ns() + 1e6
        assert at_plant.queue.empty()


@pytest.mark.integration
def test_a_message_that_came_under_another_key_than_its_own_is_dropped() -> None:
    import zenoh

    endpoints = free_endpoints(1)
    config = zenoh.Config()
    config.insert_json5("connect/endpoints", json.dumps(endpoints))
    config.insert_json5("scouting/multicast/enabled", "false")
    with ZenohBus(listen=endpoints) as plant, zenoh.open(config) as stranger:
        at_plant = Inbox(plant)
        publisher = stranger.declare_publisher(KEY)
        wait_for(lambda: bool(publisher.matching_status.matching))  # type: ignore[attr-defined]
        own, others = f"application/json;{KEY}", "application/json;wyner/v2/loop/measurement"
        publisher.put(b"misread on its way", encoding=others)
        # What names no key may come from anywhere, and is judged by its content.
        accepted = {own: b"ours", "application/json": b"no name", "zenoh/bytes": b"no encoding"}
        for encoding, payload in accepted.items():
            publisher.put(payload, encoding=encoding)
        assert [at_plant.take()[:2] for _ in accepted] == [(KEY, p) for p in accepted.values()]
        assert at_plant.queue.empty()


@pytest.mark.integration
def test_of_a_message_too_large_the_size_and_the_beginning_arrive() -> None:
    endpoints = free_endpoints(1)
    with ZenohBus(listen=endpoints) as plant, ZenohBus(connect=endpoints) as stranger:
        at_plant = Inbox(plant)
        publisher = stranger.publisher(KEY)
        wait_for(lambda: publisher.matched)
        largest = b"x" * LARGEST_MESSAGE
        publisher.put(largest)
        publisher.put(b"{}" + b" " * 10**6)
        assert at_plant.take()[1] == largest
        assert at_plant.take()[1] == b"1000002 bytes: {}" + b" " * 62


@pytest.mark.integration
def test_an_address_in_use_is_one_line_that_names_it() -> None:
    endpoints = free_endpoints(1)
    with ZenohBus(listen=endpoints), pytest.raises(TransportError) as caught:
        ZenohBus(listen=endpoints)
    assert str(caught.value) == f"{endpoints[0]}: cannot be opened: address already in use"


@pytest.mark.integration
def test_bad_keys_and_closed_buses_are_one_line() -> None:
    with ZenohBus(listen=free_endpoints(1)) as bus:
        for attempt in (
            lambda: bus.publisher("a//b"),
            lambda: bus.subscribe("a//b", lambda *_: None),
        ):
            with pytest.raises(TransportError, match="key 'a//b'") as caught:
                attempt()
            assert "\n" not in str(caught.value)
        publisher = bus.publisher(KEY)
        bus.close()
        bus.close()
        with pytest.raises(TransportError, match=KEY):
            publisher.put(b"too late")


@pytest.mark.integration
def test_a_client_waits_for_its_router_and_goes_through_it() -> None:
    endpoints = free_endpoints(1)
    opened: queue.SimpleQueue[ZenohBus] = queue.SimpleQueue()
    waiting = threading.Thread(
        target=lambda: opened.put(ZenohBus(connect=endpoints, client=True)), daemon=True
    )
    waiting.start()
    time.sleep(0.3)
    assert opened.empty()
    with (
        open_router(endpoints),
        opened.get(timeout=PATIENCE_S) as first,
        ZenohBus(connect=endpoints, client=True) as second,
    ):
        send_until_heard(first, Inbox(second))
    with pytest.raises(TransportError, match="client: expected"):
        ZenohBus(listen=endpoints, client=True)


# --- other processes -----------------------------------------------------------------------------

LISTENER = """
import sys
from runtime.zenoh_bus import ZenohBus

with ZenohBus(connect=[sys.argv[1]]) as bus:
    bus.subscribe("wyner/**", lambda *_: None)
    sys.stdin.readline()
"""


@pytest.mark.slow
@pytest.mark.integration
def test_a_frozen_listener_does_not_hold_up_the_publisher_or_the_others() -> None:
    """With congestion control BLOCK one of these puts would take two seconds or more."""
    endpoints = free_endpoints(1)
    with (
        ZenohBus(listen=endpoints) as bus,
        ZenohBus(connect=endpoints) as awake,
        started("-c", LISTENER, endpoints[0], stdin=subprocess.PIPE) as child,
    ):
        publisher = bus.publisher(KEY)
        inbox = Inbox(awake)
        send_until_heard(bus, inbox)
        marker = bus.publisher("wyner/v2/only/the/listener")
        wait_for(lambda: marker.matched)
        os.kill(child.pid, signal.SIGSTOP)
        payload = bytes(4096)
        slowest = 0.0
        sent = 0
        end = time.monotonic() + 1.0
        while time.monotonic() < end or sent < 4000:  # 16 MB: more than the sockets hold
            before = time.monotonic()
            publisher.put(payload)
            slowest = max(slowest, time.monotonic() - before)
            sent += 1
            time.sleep(0.0001)
        assert slowest < 1.9

        def heard() -> bool:
            publisher.put(b"last")  # again and again: a busy machine's way may be full
            return b"last" in inbox.payloads()

        wait_for(heard, "the last message at the listener awake")


NEVER_CLOSES = """
import sys, threading
import runtime.zenoh_bus
from runtime.command import entered
from runtime.signals import stop_on_signals

runtime.zenoh_bus._close_session = lambda _session: threading.Event().wait()

def command():
    with stop_on_signals() as stopping, runtime.zenoh_bus.ZenohBus():
        print("ready", flush=True)
        stopping.wait()
    print("ended")
    return 5

sys.exit(entered(command))
"""


@pytest.mark.slow
@pytest.mark.integration
def test_a_service_whose_session_never_closes_obeys_a_signal() -> None:
    """After a storm of declarations Zenoh's close() did not come back, and nothing ended it."""
    with started("-c", NEVER_CLOSES, stdout=subprocess.PIPE) as child:
        assert child.stdout.readline() == "ready\n"
        began = time.monotonic()
        child.terminate()
        assert child.communicate(timeout=PATIENCE_S)[0] == "ended\n"
        assert child.returncode == 5
        assert time.monotonic() - began < CLOSE_S + 5.0
