"""Whether anybody listens: Zenoh knows, and no program of the project asks."""

from typing import Any

from runtime.zenoh_bus import ZenohPublisher


def matched(*publishers: ZenohPublisher) -> bool:
    """Whether each of them knows a subscriber of its key at this moment."""
    return all(map(_matched, publishers))


def _matched(publisher: ZenohPublisher) -> bool:
    asked = publisher._declared or publisher._session.declare_publisher(publisher._key)
    status: Any = asked.matching_status  # the stub says bool, wrongly
    return bool(status.matching)
