"""The field bus between two ends that are not connected: it loses, repeats and delays."""

import json
import random
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial

from protocol.messages import Measurement, Offer
from protocol.topics import DEFAULT_LOOP, key_of
from runtime.bus import TransportError
from runtime.errors import DONE
from runtime.signals import stop_on_signals
from runtime.zenoh_bus import ZenohBus


class Relay:
    """Passes messages on, or not.

    Parameters
    ----------
    plant, controller : str
        Where each listens.
    loss, repeat : float
        Probability that a message vanishes, or arrives twice.
    delay_s : float
        Each arrival is late by a uniform time up to this, so messages overtake one another.
    seed : int
    """

    def __init__(
        self, plant: str, controller: str, loss: float, repeat: float, delay_s: float, seed: int
    ) -> None:
        self._buses = [ZenohBus(connect=[plant]), ZenohBus(connect=[controller])]
        self._draw = random.Random(seed)
        self._odds = loss, repeat, delay_s
        self.counts = {"passed": 0, "lost": 0, "repeated": 0}
        one, two = self._buses
        for kind, near, far in ((Measurement, one, two), (Offer, two, one)):
            key = key_of(kind, DEFAULT_LOOP)
            near.subscribe(key, partial(self._pass, far.publisher(key).put))

    def _pass(self, put: Callable[[bytes], None], _key: str, body: bytes, _t_ns: int) -> None:
        loss, repeat, delay_s = self._odds
        if self._draw.random() < loss:
            self.counts["lost"] += 1
            return
        twice = self._draw.random() < repeat
        self.counts["passed"] += 1
        self.counts["repeated"] += twice
        for _ in range(1 + twice):
            threading.Timer(self._draw.uniform(0.0, delay_s), self._put, (put, body)).start()

    @staticmethod
    def _put(put: Callable[[bytes], None], body: bytes) -> None:
        with suppress(TransportError):  # the relay has been closed
            put(body)

    def close(self) -> None:
        """Pass nothing on any more."""
        for bus in self._buses:
            bus.close()


def relay_until_stopped(
    plant: str,
    controller: str,
    loss: float,
    repeat: float,
    delay_s: float,
    seed: int,
    _arguments: Sequence[str] = (),
) -> int:
    """Relay until a signal comes; what was passed, lost and repeated goes to standard output."""
    with stop_on_signals() as stopping:
        relay = Relay(plant, controller, loss, repeat, delay_s, seed)
        stopping.wait()
        relay.close()
    print(json.dumps(relay.counts))
    return DONE
