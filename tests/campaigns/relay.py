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

Odds = tuple[float, float, float]


class Relay:
    """Passes messages on, or not.

    Parameters
    ----------
    plant, controller : str
        Where each listens.
    odds : tuple of float
        Probability that a message vanishes, and that it arrives twice; each arrival is late by a
        uniform time up to the third, in seconds, so messages overtake one another.
    seed : int
    """

    def __init__(self, plant: str, controller: str, odds: Odds, seed: int) -> None:
        self._buses = [ZenohBus(connect=[plant]), ZenohBus(connect=[controller])]
        self._draw = random.Random(seed)
        self._odds = odds
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
    plant: str, controller: str, odds: Odds, seed: int, _arguments: Sequence[str] = ()
) -> int:
    """Relay until a signal comes; what was passed, lost and repeated goes to standard output."""
    with stop_on_signals() as stopping:
        relay = Relay(plant, controller, odds, seed)
        stopping.wait()
        relay.close()
    print(json.dumps(relay.counts))
    return DONE
