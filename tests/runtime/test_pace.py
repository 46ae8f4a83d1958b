"""How fast plant time passes, as the user writes it."""

import pytest

from runtime.pace import Pace


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("realtime", 0.1), ("x1", 0.1), ("x10", 0.01), ("x0.5", 0.2), ("fast", None)],
)
def test_pace(text: str, seconds: float | None) -> None:
    assert Pace(text).step_s(0.1) == (None if seconds is None else pytest.approx(seconds))
    assert Pace(text).text == text


@pytest.mark.parametrize(
    "text", ["", "x", "10", "x0", "x-1", "xinf", "xnan", "xx2", "Fast", "slow"]
)
def test_a_pace_that_is_none_is_one_line(text: str) -> None:
    with pytest.raises(ValueError, match="expected realtime, fast, or xN") as caught:
        Pace(text)
    assert repr(text) in str(caught.value)
    assert "\n" not in str(caught.value)
