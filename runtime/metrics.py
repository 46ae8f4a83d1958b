"""Metrics for Prometheus: what the statuses say, at an address of the process that publishes them.

The official client does the talking; it comes with the extra ``metrics``. Nothing is counted twice:
every sample is read off the newest status of each loop when somebody asks.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import accumulate
from typing import TYPE_CHECKING, Any, Final

from pydantic_core import from_json

from protocol.messages import ControllerStatus, PlantStatus, TapStatus
from protocol.messages.base import Metric, Part
from runtime.bus import Bus, Overheard
from runtime.errors import UsageError, needs

if TYPE_CHECKING:
    from prometheus_client import Metric as Family

Statuses = dict[tuple[str, str, str], bytes]
"""The newest status of each topic, loop and eavesdropper."""

KINDS: Final = {kind.topic: kind for kind in (PlantStatus, ControllerStatus, TapStatus)}
"""The messages that have metrics."""

LABELS: Final = ("loop", "service", "eavesdropper")


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
        if topic in KINDS:
            name = from_json(payload)["name"] if topic == TapStatus.topic else ""
            self._statuses[topic, loop, name] = payload

    def left(self, loop: str) -> None:
        """Nothing is told any more of a loop that has left."""
        super().left(loop)
        for place in [place for place in list(self._statuses) if place[1] == loop]:
            del self._statuses[place]


def metrics_of(part: Part) -> Iterator[tuple[Metric, Any]]:
    """The fields of a status that are metrics, with their values; those of its parts, too."""
    for name, field in type(part).model_fields.items():
        value = getattr(part, name)
        if isinstance(value, Part):
            yield from metrics_of(value)
        yield from ((m, value) for m in field.metadata if isinstance(m, Metric))


class StatusCollector:
    """Reads the metrics off statuses whenever Prometheus asks."""

    def __init__(self, statuses: Statuses) -> None:
        self._statuses = statuses

    def collect(self) -> "Iterator[Family]":
        """The metrics, by name."""
        from prometheus_client.core import (
            CounterMetricFamily,
            GaugeMetricFamily,
            HistogramMetricFamily,
        )

        families = {
            "counter": CounterMetricFamily,
            "gauge": GaugeMetricFamily,
            "histogram": HistogramMetricFamily,
        }
        found: dict[str, Any] = {}
        for (topic, loop, name), payload in sorted(self._statuses.copy().items()):
            where = [loop, topic.split("/")[1], name]
            for metric, value in metrics_of(KINDS[topic].model_validate_json(payload)):
                if metric.name not in found:
                    family = families[metric.kind]
                    found[metric.name] = family(f"wyner_{metric.name}", metric.help, labels=LABELS)
                if metric.kind == "histogram":
                    # The counts are of buckets: the sum is not known, and is not made up.
                    edges = [*(f"{bound:g}" for bound in metric.bounds), "+Inf"]
                    buckets = list(zip(edges, accumulate(value), strict=True))
                    found[metric.name].add_metric(where, buckets, sum_value=None)
                else:
                    number = bool(value) if isinstance(value, str) else max(0, value)
                    found[metric.name].add_metric(where, number)
        yield from found.values()


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
def noted(metrics: str | None, bus: Bus) -> Iterator[Bus]:
    """The bus on which statuses are published; at ``metrics`` Prometheus is answered too.

    Raises
    ------
    UsageError
        When it cannot be.
    """
    if metrics is None:
        yield bus
        return
    statuses: Statuses = {}
    with served(metrics, statuses):
        yield NotedBus(bus, statuses)


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
