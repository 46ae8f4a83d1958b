"""Metrics for Prometheus: what the statuses say, at an address of the process that publishes them.

The official client does the talking; it comes with the extra ``metrics``. Nothing is counted twice:
every sample is read off the newest status of each loop when somebody asks.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from pydantic_core import from_json

from protocol.messages import LATENCY_BOUNDS_S, ControllerStatus, PlantStatus, TapStatus
from runtime.bus import Bus, Overheard
from runtime.errors import UsageError, needs

if TYPE_CHECKING:
    from prometheus_client import Metric

Statuses = dict[tuple[str, str, str], bytes]
"""The newest status of each topic, loop and eavesdropper."""

COUNTERS = {
    PlantStatus.topic: {
        "k": ("steps", "steps that the plant made, missed ones too"),
        "missed": ("missed_steps", "steps without an offer in time"),
        "late": ("late_offers", "offers that came after their step"),
        "agreements": ("agreements", "transitions on which a key symbol was agreed"),
        "symbol_errors": ("symbol_errors", "agreements on a symbol that was not applied"),
        "messages": ("messages_recovered", "whole messages that the plant has"),
        "frames_refused": ("frames_refused", "frames that failed their check"),
        "malformed": ("malformed", "messages that were no messages"),
        "keys_made": ("keys_made", "keys of confirmed blocks since this process began"),
        "key_blocks_lost": ("keys_blocks_lost", "key blocks that made no key since then"),
    },
    ControllerStatus.topic: {
        "delivered": ("messages_delivered", "messages of which every symbol was counted"),
        "alarms": ("alarms", "transitions whose test failed and made an alarm"),
        "watched": ("watched_steps", "transitions tested by a key's candidate"),
        "unwatched": ("unwatched_steps", "transitions that no key watched, of a keyed coin"),
        "malformed": ("malformed", "messages that were no messages"),
        "keys_made": ("keys_made", "keys of confirmed blocks since this process began"),
        "key_blocks_lost": ("keys_blocks_lost", "key blocks that made no key since then"),
    },
    TapStatus.topic: {
        "mirrored": ("tap_mirrored", "messages in the tap's recording"),
        "dropped": ("tap_dropped", "messages that the tap heard and lost"),
        "lost": ("tap_lost", "transitions of which the tap lacks a message"),
        "malformed": ("malformed", "messages that were no messages"),
        "key_blocks": ("keys_blocks_attacked", "key blocks that the eavesdropper went for"),
        "key_bits_held": ("keys_bits_held", "bits of their rows that she can compute"),
        "copies": ("keys_copies", "first copies that were sent, as far as she can tell"),
        "copies_missed": ("keys_copies_missed", "first copies that she missed"),
    },
}

GAUGES = {
    PlantStatus.topic: {
        "keys_stopped": ("keys_stopped", "whether the newest block made no key"),
        "digits_left": ("keys_digits_left", "unused digits of the key stream"),
    },
    ControllerStatus.topic: {
        "keys_stopped": ("keys_stopped", "whether the newest block made no key"),
        "digits_left": ("keys_digits_left", "unused digits of the key stream"),
    },
    TapStatus.topic: {
        "claim_refuted": (
            "keys_claim_refuted",
            "whether she misses less than the operator claims (eps_E)",
        ),
        "misses_in_bursts": ("keys_misses_in_bursts", "whether her misses come in bursts"),
    },
}
"""What is so now: a number, or whether it is so (1) or not (0)."""


class NotedBus(Overheard):
    """A bus of whose published statuses the newest of each kind and loop are kept.

    Parameters
    ----------
    bus : Bus
        Closed by whoever opened it.
    statuses : dict
    """

    def __init__(self, bus: Bus, statuses: Statuses) -> None:
        super().__init__(bus, self._note)
        self._statuses = statuses

    def _note(self, key: str, payload: bytes) -> None:
        _base, _version, loop, topic = key.split("/", 3)
        if topic in COUNTERS:
            name = from_json(payload)["name"] if topic == TapStatus.topic else ""
            self._statuses[topic, loop, name] = payload

    def left(self, loop: str) -> None:
        """Nothing is told any more of a loop that has left."""
        super().left(loop)
        for place in [place for place in list(self._statuses) if place[1] == loop]:
            del self._statuses[place]


class StatusCollector:
    """Reads the metrics off statuses whenever Prometheus asks."""

    def __init__(self, statuses: Statuses) -> None:
        self._statuses = statuses

    def collect(self) -> "Iterator[Metric]":
        """The metrics, by name."""
        from prometheus_client.core import (
            CounterMetricFamily,
            GaugeMetricFamily,
            HistogramMetricFamily,
        )

        found: dict[str, CounterMetricFamily | GaugeMetricFamily] = {}
        kinds = ((CounterMetricFamily, COUNTERS), (GaugeMetricFamily, GAUGES))
        latency = HistogramMetricFamily(
            "wyner_offer_latency_seconds",
            "from a step's first measurement to its offer",
            labels=["loop"],
        )
        for (topic, loop, name), payload in sorted(self._statuses.copy().items()):
            status: dict[str, Any] = from_json(payload)
            service = topic.split("/")[1]
            for kind, fields in kinds:
                for field, (metric, text) in fields[topic].items():
                    if metric not in found:
                        labels = ["loop", "service", "eavesdropper"]
                        found[metric] = kind(f"wyner_{metric}", text, labels=labels)
                    value = status[field]
                    value = bool(value) if isinstance(value, str) else max(0, value)
                    found[metric].add_metric([loop, service, name], value)
            if topic == PlantStatus.topic:
                self._histogram(latency, loop, status["latency_counts"])
        yield from found.values()
        yield latency

    def _histogram(self, latency: Any, loop: str, counts: list[int]) -> None:
        buckets, total = [], 0
        for bound, count in zip((*LATENCY_BOUNDS_S, float("inf")), counts, strict=True):
            total += count
            buckets.append((f"{bound:g}" if bound < float("inf") else "+Inf", float(total)))
        # The counts are of buckets: the sum is not known, and is not made up.
        latency.add_metric([loop], buckets, sum_value=None)


def host_and_port(address: str) -> tuple[str, int]:
    """What ``--metrics`` names.

    Raises
    ------
    UsageError
        When it is no ``HOST:PORT``.
    """
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal() or int(port) > 65535:
        raise UsageError(f"--metrics: got {address!r}, expected HOST:PORT")
    return host.strip("[]"), int(port)


@contextmanager
def served(address: str, statuses: Statuses) -> Iterator[int]:
    """Answer Prometheus at ``HOST:PORT`` (port 0: any free one); gives the port.

    Raises
    ------
    UsageError
        When the address is none or in use, or the client is not installed.
    """
    host, port = host_and_port(address)
    try:
        from prometheus_client import CollectorRegistry, start_http_server
    except ImportError:
        raise UsageError(needs("--metrics", "prometheus-client")) from None
    registry = CollectorRegistry()
    registry.register(StatusCollector(statuses))
    try:
        server, thread = start_http_server(port, host, registry=registry)
    except OSError as error:
        raise UsageError(f"--metrics: {address}: {error.strerror or error}") from None
    try:
        yield server.server_port
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
