"""The status of an end, as it would tell it now."""

from typing import Any

from protocol.link.endpoint import Endpoint


def status_of(core: Endpoint, now: float | None = None) -> Any:
    """The status of an end, at ``now``."""
    state = core.state
    state.now = state.now if now is None else now
    return core.news.status(state, core.malformed)
