"""Shipped scenarios with something else in them."""

from typing import Any

from protocol.scenario import Scenario, parse_scenario
from runtime.scenario_file import scenario_of
from runtime.shipped import SCENARIOS


def changed(name: str, **tables: dict[str, Any]) -> Scenario:
    """One with other values in fields of its tables; None takes a field away."""
    data = scenario_of(name).model_dump(mode="json", exclude_none=True)
    for table, fields in tables.items():
        both = data.get(table, {}) | fields
        data[table] = {field: value for field, value in both.items() if value is not None}
    return parse_scenario(data, name)


def put(tables: dict[str, Any], path: str, value: Any) -> None:
    """Another value in a field of a file's tables, by the names and places on the way to it.

    None takes the field away.
    """
    *parents, last = path.split(".")
    at: Any = tables
    for name in parents:
        at = at[int(name)] if isinstance(at, list) else at.setdefault(name, {})
    if value is None:
        del at[last]
    else:
        at[int(last) if isinstance(at, list) else last] = value


def text_of(name: str, *changes: tuple[str, str]) -> str:
    """The text of one, with other pieces in the place of some, each of which is there once."""
    text = (SCENARIOS / f"{name}.toml").read_text(encoding="utf-8")
    for old, new in changes:
        assert text.count(old) == 1, f"{name}: {text.count(old)} times {old!r}"
        text = text.replace(old, new)
    return text
