"""What was expected of a field that pydantic refuses, in the words of this project's messages."""

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

EXPECTED: Final = {
    "tuple_type": 'expected a list, such as [1.0] or ["name"]',
    "missing": "expected here, and not given",
    "extra_forbidden": "no such field",
    "float_type": "expected a number",
    "int_type": "expected a whole number",
    "model_type": "expected a table",
    "model_attributes_type": "expected a table",
}
"""What pydantic's errors are called where a reader would not know its words."""


def expected_of(item: "ErrorDetails") -> str:
    """What was expected, of one of a ``ValidationError``'s errors."""
    message = EXPECTED.get(item["type"], item["msg"].removeprefix("Value error, "))
    message = message.replace("Input should be", "expected", 1)
    return f"{message[:1].lower()}{message[1:]}"
