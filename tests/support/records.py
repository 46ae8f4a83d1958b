"""Records of the two ends, told by the names of their fields, whichever part has them."""

from typing import Any, TypeVar

from protocol.link.records import (
    AppliedRecord,
    ControllerRecord,
    LinkRecord,
    PlantRecord,
    PlantSessionRecord,
)

NAMES = {
    "session": "id",
    "applied_copy": "copy",
    "frames_refused": "refused",
    "blocks_begun": "begun",
}
"""Names by which the tests tell a field of a part that has a shorter one."""

R = TypeVar("R", PlantRecord, ControllerRecord)


def plant_record(session: str, k: int, x: Any, u: Any, **more: Any) -> PlantRecord:
    first = PlantRecord(PlantSessionRecord(session), LinkRecord(k, x), AppliedRecord(u))
    return changed(first, **more)


def controller_record(**fields: Any) -> ControllerRecord:
    return changed(ControllerRecord(), **fields)


def changed(record: R, **fields: Any) -> R:
    """The record with other values in some fields of its parts."""
    parts = record._asdict()
    for told, value in fields.items():
        name = NAMES.get(told, told)
        if name == "offer":
            parts["offer"] = value
            continue
        (part,) = [p for p, of in parts.items() if name in getattr(of, "_fields", ())]
        parts[part] = parts[part]._replace(**{name: value})
    return type(record)(**parts)
