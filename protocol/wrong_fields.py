"""Fields that pydantic refuses, in the words of this project's messages."""

import json
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from pydantic import ValidationError
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


def wrong_fields(error: "ValidationError") -> list[str]:
    """One line for each wrong field: its path, the value, what was expected."""
    lines = []
    for item in error.errors(include_url=False):
        path = ".".join(str(part) for part in item["loc"] if part not in ("number", "entries"))
        message = expected_of(item)
        if item["type"] == "value_error" and not path:
            lines += message.split("; ")
            continue
        try:
            value = json.dumps(item["input"], default=str)
        except ValueError:  # 0x... may be longer than Python writes out
            value = "an endless number"
        shown = value if len(value) <= 60 else value[:57] + "..."
        got = "" if item["type"] == "missing" else f" got {shown},"
        lines.append(f"{path or 'file'}:{got} {message}")
    return lines
