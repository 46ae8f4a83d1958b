"""What a status that a service writes once a second says of its health."""

from pathlib import Path
from typing import Any, TypeVar

from protocol.messages import ControllerStatus, PlantStatus
from runtime.errors import Failure
from runtime.files import read_regular
from runtime.services import Look

S = TypeVar("S", PlantStatus, ControllerStatus)


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


def look_at_status(folder: Path, now_s: float) -> Look:
    """Look at ``status.json``: its age, and the transitions that it counts.

    Raises
    ------
    Failure
        When there is none, or it is not one.
    """
    from pydantic_core import from_json

    path = folder / "status.json"
    try:
        status = from_json(read_regular(path))
        age_s = now_s - status["t_ns"] / 1e9
        count = int(status["transitions"])
        phase = status["phase"]
    except OSError as error:
        raise Failure(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError):
        raise Failure(f"{path}: expected a status with t_ns, transitions and phase") from None
    detail = f" ({status['detail']})" if status.get("detail") else ""
    stopped = f"; keys stopped: {why}" if (why := status.get("keys_stopped")) else ""
    text = f"{phase}{detail}, {count} transitions{stopped}"
    return Look(age_s, count, text, str(status.get("health", "")))
