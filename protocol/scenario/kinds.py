"""Tables whose fields depend on a kind: the registries that know the kinds, and the choice.

A control law brings the table that it reads: a subclass of the common one. Where a process imports
no room that provides kinds, as the plant's process imports no law's, the fields of a kind are kept
as they stand: whoever serves the kind checks them.
"""

from collections.abc import Iterator
from typing import Any, ClassVar, TypeVar

from pydantic import ValidatorFunctionWrapHandler, WrapValidator
from pydantic_core import InitErrorDetails, PydanticCustomError, ValidationError

from protocol.registry import Registry, UnknownError
from protocol.scenario.control import Control
from protocol.scenario.parts import ScenarioTable
from protocol.scenario.plant import PlantTable

LAWS: Registry[type[Control]] = Registry("law")
"""For each name of ``control.law`` the table ``[control]`` that this law reads."""

PLANTS: Registry[type[PlantTable]] = Registry("plant")
"""For each kind of plant the table ``[plant]`` that it reads."""

P = TypeVar("P", bound=ScenarioTable)


class UncheckedControl(Control, extra="allow"):
    """``[control]`` of a law that this process does not know."""

    needs_gain: ClassVar[bool] = False

    def count_problems(self, candidates: int) -> Iterator[str]:  # noqa: ARG002
        """None: this process does not know the law's fields."""
        yield from ()

    def coin_problems(self) -> Iterator[str]:
        """None: this process does not know the law."""
        yield from ()


class UncheckedPlant(PlantTable, extra="allow"):
    """``[plant]`` of a kind that this process does not know."""


def by_kind(
    registry: Registry[type[P]], common: type[P], unchecked: type[P], field: str
) -> WrapValidator:
    """A validator that reads a table by the model registered for the kind that it names.

    Parameters
    ----------
    registry : Registry
        Subclasses of ``common`` by kind.
    common, unchecked : type
        The fields that every kind has; the same, with any others besides.
    field : str
        The field of the table that names the kind.
    """

    def read(table: object, handler: ValidatorFunctionWrapHandler) -> Any:
        if not isinstance(table, dict):
            return handler(table)
        if not registry.served:
            return unchecked.model_validate(table)
        kind = table.get(field, common.model_fields[field].default)
        try:
            model = registry[kind] if isinstance(kind, str) else None
        except UnknownError as error:
            model = None
            why = str(error).removeprefix(f"got {kind!r}, ")
        else:
            why = "expected a name"
        if model is None:
            problem = InitErrorDetails(
                type=PydanticCustomError("kind", "{why}", {"why": why}), loc=(field,), input=kind
            )
            raise ValidationError.from_exception_data(common.__name__, [problem])
        return model.model_validate(table)

    return WrapValidator(read)
