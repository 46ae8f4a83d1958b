"""What an alarm says in words."""

import pytest

from protocol.link.events import Alarm, Reason


@pytest.mark.parametrize(
    ("reason", "said", "of_a_reading"),
    [
        ("unexplained", "by the nearest of all candidates, 3;", True),
        ("another candidate", "by candidate 3, which the key stream chose;", True),
        ("unwatched", "too many steps had no digit", False),
        ("digits refused", "the plant denies digits", False),
    ],
)
def test_an_alarm_tells_its_step_and_its_reading_beside_what_was_expected(
    reason: Reason, said: str, of_a_reading: bool
) -> None:
    words = Alarm("1" * 16, 2, 31, (0.125, -4.0), reason, 3, (0.5, 2.25), 6.5).sentence()
    assert said in words
    assert "step 31:" in words
    for one in ("(0.125, -4)", "(0.5, 2.25)", "6.5 times"):
        assert (one in words) == of_a_reading, one
