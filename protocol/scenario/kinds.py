"""Tables whose fields depend on a kind, ``[plant]`` and ``[control]``: each has a model."""

from collections.abc import Callable
from typing import Any, Final, TypeVar

from pydantic import ValidatorFunctionWrapHandler, WrapValidator
from pydantic_core import InitErrorDetails, PydanticCustomError, ValidationError

from protocol.plugins import UnknownError, load, names_a_file
from protocol.scenario.control import Control
from protocol.scenario.laws import PackedControl, PaperControl
from protocol.scenario.parts import ScenarioTable
from protocol.scenario.plant import PlantTable
from protocol.scenario.plants import PLANTS

T = TypeVar("T")

LAWS: Final[dict[str, type[Control]]] = {
    "paper": PaperControl,
    "sustained": Control,
    "packed": PackedControl,
}
"""For each shipped law the table ``[control]`` that it reads."""


def law_table(name: str) -> type[Control]:
    """The table of a law, shipped or in a file of the user's, whose class names it as ``table``.

    Raises
    ------
    UnknownError
        When there is no such law.
    """
    if name in LAWS or not names_a_file(name):
        return _among(name, LAWS, ", or path/to/file.py:Name")
    found = load(name, {})
    if not (isinstance(found, type) and callable(getattr(found, "synthesise", None))):
        raise UnknownError(
            f"got {name!r}, expected a class {name.rpartition(':')[2]} that extends "
            "controller_service.laws.base.ProgramLaw, or has its methods"
        )
    table = getattr(found, "table", Control)
    if not (isinstance(table, type) and issubclass(table, Control)):
        raise UnknownError(
            f"{name}: expected its table to be a class that extends protocol.scenario.Control, "
            f"got {table!r}"
        )
    return table


def plant_table(name: str) -> type[PlantTable]:
    """The table of a kind of plant.

    Raises
    ------
    UnknownError
        When there is none.
    """
    return _among(name, PLANTS)


def _among(name: str, tables: dict[str, T], besides: str = "") -> T:
    if name not in tables:
        raise UnknownError(f"got {name!r}, expected {', '.join(tables)}{besides}")
    return tables[name]


def by_kind(field: str, default: str, table_of: Callable[[str], type[ScenarioTable]]) -> Any:
    """A validator that reads a table by the model of the kind that its ``field`` names."""

    def read(table: object, handler: ValidatorFunctionWrapHandler) -> Any:
        if not isinstance(table, dict):
            return handler(table)
        kind = table.get(field, default)
        try:
            if not isinstance(kind, str):
                raise UnknownError("expected a name")
            return table_of(kind).model_validate(table)
        except UnknownError as error:
            why = str(error).removeprefix(f"got {kind!r}, ")
            problem = InitErrorDetails(
                type=PydanticCustomError("kind", "{why}", {"why": why}), loc=(field,), input=kind
            )
            raise ValidationError.from_exception_data(field, [problem]) from None

    return WrapValidator(read)
