"""Results as JSON has them."""

from collections.abc import Collection, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from pydantic import BaseModel

from protocol.statistics import Interval


def plain(value: Any, without: Collection[str] = ()) -> Any:
    """A value as JSON has it: what has fields by their names, a sequence as a list.

    Parameters
    ----------
    value : object
    without : collection of str
        Fields that are left out.
    """
    if isinstance(value, Interval):
        return value.as_json()
    if isinstance(value, BaseModel):
        return value.model_dump(exclude=set(without))
    if is_dataclass(value):
        names = (field.name for field in fields(value) if field.name not in without)
        return {name: plain(getattr(value, name)) for name in names}
    if isinstance(value, Mapping):
        return {name: plain(one) for name, one in value.items()}
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return {name: plain(one) for name, one in value._asdict().items()}
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    return value
