"""Each event as the line that stands in a trace: readers of old traces count on every name."""

from typing import Any

import pytest

from protocol.agreement import AgreementResult
from protocol.link.events import (
    Alarm,
    Reason,
    lines,
)
from protocol.link.session import CountedTransition
from protocol.messages import SendCommand

S = "1" * 16
TRANSITION = CountedTransition(
    session=S,
    j=2,
    k=3,
    x=(1.0,),
    candidates=((2.0,), (4.0,)),
    cipher=1,
    x_next=(3.5,),
    role="test",
    verdict=AgreementResult((0.5, 1.5), 0),
    symbol=0,
    key=-1,
    message_symbol=-1,
    p=4,
    s=2,
    tested=True,
    counts=3,
)
TOLD = {
    "event": "transition",
    "session": S,
    "j": 2,
    "k": 3,
    "x": (1.0,),
    "candidates": ((2.0,), (4.0,)),
    "cipher": 1,
    "x_next": (3.5,),
    "role": "test",
    "gauges": (0.5, 1.5),
    "symbol": 0,
    "key": -1,
    "message_symbol": -1,
    "p": 4,
    "s": 2,
    "counts": 3,
}
COMMAND = SendCommand(id="m1", payload=b"a")


@pytest.mark.parametrize(
    ("what", "line"),
    [
        ({"delivered": COMMAND}, {"event": "delivered", "id": "m1", "payload": "YQ=="}),
        ({"recovered": b"a"}, {"event": "recovered", "payload": "YQ=="}),
        ({"recovered": b""}, {"event": "recovered", "payload": ""}),
        ({"refused": True}, {"event": "refused", "session": S, "p": 4}),
    ],
)
def test_a_transition_reports_on_the_frame_that_it_completed(
    what: dict[str, Any], line: dict[str, Any]
) -> None:
    completed = TRANSITION._replace(**what)
    assert lines(completed) == (TOLD, line)
    assert completed.shared == TRANSITION, "the report is that of one side"


@pytest.mark.parametrize(
    ("reason", "whose"),
    [("unexplained", "all candidates"), ("another candidate", "the key stream chose")],
)
def test_an_alarm_is_told_with_its_step_its_reading_and_what_was_expected(
    reason: Reason, whose: str
) -> None:
    alarm = Alarm(S, 2, 31, (0.125, -4.0), reason, 3, (0.5, 2.25), 6.5)
    assert alarm.as_event() == {"event": "alarm", **alarm._asdict()}
    words = alarm.sentence()
    assert all(said in words for said in ("31", "0.125, -4", "0.5, 2.25", "6.5", " 3", whose))


# --- key blocks -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("reason", "what"),
    [("unwatched", "too many steps had no digit"), ("digits refused", "the plant denies digits")],
)
def test_an_alarm_over_digits_tells_of_no_reading(reason: Reason, what: str) -> None:
    words = Alarm(S, 2, 31, (0.125, -4.0), reason, 3, (0.5, 2.25), 6.5).sentence()
    assert what in words
    assert "31" in words
    assert "0.125" not in words
