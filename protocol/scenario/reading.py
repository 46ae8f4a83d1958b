"""Scenarios read from parsed tables: each wrong field in one line."""

from collections.abc import Iterator, Mapping, Sequence
from math import inf
from typing import Any, Final

from pydantic import ValidationError

from protocol.errors import WynerError
from protocol.scenario.system import Scenario
from protocol.wrong_fields import wrong_fields

LARGEST_NUMBER: Final = 1e150
"""Of every number in a scenario: the square of one beyond is no number to a computer."""


class ScenarioError(WynerError):
    """A scenario that cannot be used; ``problems`` holds one line for each wrong field."""

    def __init__(self, problems: Sequence[str]) -> None:
        super().__init__("\n".join(problems))
        self.problems = tuple(problems)


def _beyond(value: object, path: tuple[str, ...] = ()) -> Iterator[str]:
    """Numbers too large for any field, a line each; of any length, and in tables of any kind."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _beyond(item, (*path, str(key)))
    elif isinstance(value, list | tuple):
        for number, item in enumerate(value):
            yield from _beyond(item, (*path, str(number)))
    elif isinstance(value, int | float) and abs(value) > LARGEST_NUMBER and abs(value) != inf:
        what = f"got {value!r}" if isinstance(value, float) else "got a longer one"
        yield f"{'.'.join(path)}: {what}, expected a number of at most {LARGEST_NUMBER:g}"


def with_fields(scenario: Scenario, changes: Mapping[str, Any], source: str) -> Scenario:
    """A scenario with other values in some fields.

    Parameters
    ----------
    scenario : Scenario
    changes : mapping
        By the path of a field: names and places with dots between.
    source : str
        Stands first in each line of an error.

    Raises
    ------
    ScenarioError
        When there can be no such field, or the whole is no scenario any more.
    """
    data = scenario.model_dump(mode="json", exclude_none=True, exclude_unset=True)
    for path, value in changes.items():
        place: Any = data
        *parents, last = path.split(".")
        try:
            for name in parents:
                place = place[int(name)] if isinstance(place, list) else place.setdefault(name, {})
            place[int(last) if isinstance(place, list) else last] = value
        except (AttributeError, IndexError, TypeError, ValueError):
            line = f"{source}: {path}: expected the path of a scenario's field"
            raise ScenarioError([line]) from None
    return parse_scenario(data, source)


def parse_scenario(data: dict[str, Any], source: str) -> Scenario:
    """Build a scenario from parsed TOML.

    Raises
    ------
    ScenarioError
        With one line for each wrong field; shapes are compared once every field by itself is right.
    """
    try:
        if beyond := [f"{source}: {line}" for line in _beyond(data)]:
            raise ScenarioError(beyond)
        return Scenario.model_validate(data)
    except ValidationError as error:
        raise ScenarioError([f"{source}: {line}" for line in wrong_fields(error)]) from None
