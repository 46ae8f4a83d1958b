"""A multicast group of several sessions that listen to the same keys stays quiet."""

import secrets
import socket
import struct
import threading
import time
from contextlib import ExitStack, suppress

import pytest

from runtime.zenoh_bus import ZenohBus
from tests.support.patience import PATIENCE_S

GROUP = "224.0.0.231"
MEASUREMENT, OFFER = "wyner/v3/loop/field/measurement", "wyner/v3/loop/field/offer"


class Counter:
    """Counts the datagrams of a group on this machine."""

    def __init__(self, port: int) -> None:
        self.frames = 0
        self._over = threading.Event()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        self._socket.bind((GROUP, port))
        member = struct.pack("4s4s", socket.inet_aton(GROUP), socket.inet_aton("127.0.0.1"))
        self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
        self._socket.settimeout(0.1)
        self._thread = threading.Thread(target=self._count, daemon=True)
        self._thread.start()

    def _count(self) -> None:
        while not self._over.is_set():
            with suppress(TimeoutError):
                self._socket.recv(1 << 16)
                self.frames += 1

    def close(self) -> None:
        self._over.set()
        self._thread.join(PATIENCE_S)
        self._socket.close()


@pytest.mark.slow
@pytest.mark.integration
def test_many_who_listen_to_the_same_keys_do_not_answer_one_another() -> None:
    """Three taps and both ends: each greets four times a second, and each end speaks ten times."""
    port = 20_000 + secrets.randbelow(10_000)
    group = [f"udp/{GROUP}:{port}#iface=lo"]
    with ExitStack() as stack:
        counter = Counter(port)
        stack.callback(counter.close)
        try:
            taps = [stack.enter_context(ZenohBus(listen=group)) for _ in range(3)]
            plant, controller = (stack.enter_context(ZenohBus(listen=group)) for _ in range(2))
        except OSError as error:
            pytest.skip(f"no multicast on this machine: {error}")
        time.sleep(1.0)  # each has heard the greetings of the others
        heard = [0] * 5
        for i, (bus, keys) in enumerate(
            [*((tap, (MEASUREMENT, OFFER)) for tap in taps), (plant, (OFFER,))]
        ):
            for key in keys:

                def count(*_: object, i: int = i) -> None:
                    heard[i] += 1

                bus.subscribe(key, count)

        def count_here(*_: object) -> None:
            heard[4] += 1

        controller.subscribe(MEASUREMENT, count_here)
        measure, offer = plant.publisher(MEASUREMENT), controller.publisher(OFFER)
        time.sleep(0.5)
        before, frames = list(heard), counter.frames
        for _ in range(30):
            measure.put(b"x" * 200)
            time.sleep(0.05)
            offer.put(b"u" * 200)
            time.sleep(0.05)
        time.sleep(0.2)
        told = [now - then for now, then in zip(heard, before, strict=True)]
        assert counter.frames - frames < 300
        assert told == [60, 60, 60, 30, 30]


def test_in_a_group_no_two_spell_a_key_alike_and_all_mean_the_same() -> None:
    import zenoh

    with ZenohBus(listen=[f"udp/{GROUP}:20000#iface=lo"]) as bus:
        exact, every_loop = MEASUREMENT, "wyner/v3/*/field/offer"
        spelled = {bus.spelling(exact) for _ in range(100)}
        assert len(spelled) == 100
        assert all(zenoh.KeyExpr(one).includes(exact) for one in spelled)
        assert all(not zenoh.KeyExpr(one).intersects(OFFER) for one in spelled)
        assert zenoh.KeyExpr(bus.spelling(every_loop)).includes(every_loop)
    with ZenohBus() as alone:
        assert alone.spelling(exact) == exact
