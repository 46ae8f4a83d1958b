"""An error of use is a line a field."""

from runtime.errors import UsageError


def test_a_usage_error_has_a_line_a_field() -> None:
    assert UsageError("one").lines == ("one",)
    assert UsageError(["a: x", "b: y"]).lines == ("a: x", "b: y")
    assert str(UsageError(["a: x", "b: y"])) == "a: x\nb: y"
