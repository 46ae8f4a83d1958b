"""The tap among the services."""

from pathlib import Path

from runtime.errors import Failure
from runtime.services import (
    CONTROLLER_FIELD,
    PLANT_FIELD,
    TAP_ADVERSARY,
    Ends,
    Look,
    Service,
    register,
)


def look_at_capture(folder: Path, now_s: float) -> Look:
    """Look at what the tap has written: its beliefs' age, and the bytes of its capture.

    Parts of a capture are removed when they grow old, so the newest part's time stands in for what
    was written before.

    Raises
    ------
    Failure
        When nothing is there.
    """
    try:
        age_s = now_s - (folder / "beliefs.json").stat().st_mtime
        parts = [part.stat() for part in folder.glob("capture*.jsonl")]
    except OSError as error:
        raise Failure(f"{error.filename}: cannot be read: {error.strerror}") from None
    if not parts:
        raise Failure(f"{folder}: expected a capture")
    newest = max(part.st_mtime_ns for part in parts)
    return Look(age_s, newest, f"{sum(part.st_size for part in parts)} bytes captured")


register(
    Service(
        name="tap",
        summary="run the tap service with its eavesdroppers",
        package="tap_service",
        command="tap_service.command",
        ends={
            "field": Ends((), (PLANT_FIELD, CONTROLLER_FIELD)),
            "adversary": Ends((TAP_ADVERSARY,)),
        },
        publishes={"adversary": ("adversary/tap/status",)},
        health=look_at_capture,
        stop_s=25.0,  # heavy eavesdroppers think to the end of what they heard
    )
)
