"""The events of a trace, whole in memory; and what was recovered, while it is written."""

import base64
from pathlib import Path
from typing import Any

from runtime.recording import decode, parts_of
from runtime.run_folder import PLANT_TRACE

Event = dict[str, Any]


def events_of(path: Path, kind: str) -> list[Event]:
    """The events of one kind in all parts of a trace, in order, without torn lines.

    What a killed writer wrote twice comes twice.
    """
    lines = [line for part in parts_of(path) for line in part.read_bytes().splitlines()]
    events = filter(None, map(decode, lines))
    return [event for event in events if event.get("event") == kind]


def recovered_in(run_dir: Path) -> list[bytes]:
    """The messages that the plant of a run has recovered so far, in order."""
    found = events_of(run_dir / PLANT_TRACE, "recovered")
    return [base64.b64decode(event["payload"]) for event in found]
