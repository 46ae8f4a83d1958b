"""The status of an end, as it would tell it now or has written it, and one with other values."""

import json
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel

from protocol.link.endpoint import Endpoint

M = TypeVar("M", bound=BaseModel)


def status_of(core: Endpoint, now: float | None = None) -> Any:
    """The status of an end, at ``now``."""
    state = core.state
    state.now = state.now if now is None else now
    return core.news.status(state, core.malformed)


def changed(part: M, **fields: Any) -> M:
    """A status with other values; a dict has those of a part."""
    update = {
        name: changed(getattr(part, name), **value) if isinstance(value, dict) else value
        for name, value in fields.items()
    }
    return part.model_copy(update=update)


def read_status(path: Path, kind: type[M]) -> M:
    """The status in a run's folder, without its field ``health``."""
    fields = json.loads(path.read_bytes())
    del fields["health"]
    return kind.model_validate(fields)
