"""What every table of a scenario file is made of: its base class and the forms of its values."""

from collections.abc import Iterator
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from protocol.vectors import FiniteMatrix

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class ScenarioTable(BaseModel):
    """A table of a scenario file: unknown fields are errors, values cannot change."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def __hash__(self) -> int:
        """Of all values, also of those that hold names or lists of a user's choice."""
        return hash((type(self), *map(_hashable, self.__dict__.values())))


def _hashable(value: object) -> object:
    if isinstance(value, dict):
        return frozenset((name, _hashable(part)) for name, part in value.items())
    return tuple(map(_hashable, value)) if isinstance(value, list) else value


def check_matrix(matrix: FiniteMatrix) -> FiniteMatrix:
    """The matrix, or ValueError where it is empty or ragged."""
    if not matrix or not matrix[0]:
        raise ValueError("expected at least one row and one column")
    if len({len(row) for row in matrix}) != 1:
        raise ValueError("expected rows of one length")
    return matrix


def shape(matrix: FiniteMatrix) -> tuple[int, int]:
    """Rows and columns."""
    return len(matrix), len(matrix[0])


def shape_problem(path: str, got: object, expected: object) -> Iterator[str]:
    """One line when two shapes differ."""
    if got != expected:
        yield f"{path}: got shape {got}, expected {expected}"
