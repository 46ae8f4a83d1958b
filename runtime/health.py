"""What a status that a service writes once a second says of its health."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

from runtime.errors import UsageError
from runtime.files import read_regular

if TYPE_CHECKING:
    from protocol.messages import ControllerStatus, PlantStatus

S = TypeVar("S", "PlantStatus", "ControllerStatus")


@dataclass(frozen=True, slots=True)
class Look:
    """One look at a service: how old its report is, what it has counted, and its own line.

    ``health`` begins with ``ok`` or ``bad`` and says why; it is empty where the service has none.
    """

    age_s: float
    count: int
    text: str
    health: str = ""


def read_status(path: Path, kind: type[S]) -> S:
    """The status in a run's folder, without its field ``health``.

    Raises
    ------
    OSError, ValueError
        When there is none, or it is not one.
    """
    from pydantic_core import from_json, to_json

    fields: dict[str, Any] = from_json(read_regular(path))
    fields.pop("health", None)
    return kind.model_validate_json(to_json(fields))


COUNTED: Final = {
    "transitions": "transitions",
    "captured": "messages captured",
    "count": "counted",
}
"""What a status may count, and what that is called."""


def look_at_status(folder: Path, now_s: float) -> Look:
    """Look at ``status.json``: its age, and what it counts.

    Raises
    ------
    UsageError
        When there is none, or it is not one.
    """
    from pydantic_core import from_json

    path = folder / "status.json"
    try:
        status = from_json(read_regular(path))
        age_s = now_s - status["t_ns"] / 1e9
        field = next(field for field in COUNTED if field in status)
        count = int(status[field])
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, StopIteration):
        fields = ", ".join(COUNTED)
        raise UsageError(f"{path}: expected a status with t_ns and one of {fields}") from None
    detail = f" ({status['detail']})" if status.get("detail") else ""
    phase = f"{status['phase']}{detail}, " if "phase" in status else ""
    stopped = f"; keys stopped: {why}" if (why := status.get("keys_stopped")) else ""
    text = f"{phase}{count} {COUNTED[field]}{stopped}"
    return Look(age_s, count, text, str(status.get("health", "")))
