"""Each event as the line that stands in a trace: readers of old traces count on every name."""

from typing import Any

import pytest

from protocol.agreement import AgreementResult
from protocol.link.distiller import BlockEnded, Distiller
from protocol.link.effects import Notice
from protocol.link.events import (
    Alarm,
    Reason,
    lines,
)
from protocol.link.key_events import block_notices, extraction_done
from protocol.link.session import CountedTransition
from protocol.messages import SendCommand
from protocol.secret.blocks import ExtractionFailed, Schedule
from protocol.secret.bound import Assumption
from runtime.chance import fresh_nonce

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


@pytest.mark.parametrize(
    ("reason", "what"),
    [("unwatched", "too many steps had no digit"), ("digits refused", "the plant denies digits")],
)
def test_an_alarm_over_digits_tells_of_no_reading(reason: Reason, what: str) -> None:
    words = Alarm(S, 2, 31, (0.125, -4.0), reason, 3, (0.5, 2.25), 6.5).sentence()
    assert what in words
    assert "31" in words
    assert "0.125" not in words


# --- key blocks -----------------------------------------------------------------------------------

SCHEDULE = Schedule(Assumption(0.1), 32, 64)
FIRST = BlockEnded(S, 0, "confirmed", 5)
CLAIM = f"first keys of session {S}: {SCHEDULE.assumption.sentence()}"
DIFFERS = f"key block 2 of session {S} differs from the partner's"


@pytest.mark.parametrize(
    ("ended", "notices"),
    [
        (FIRST, (Notice(CLAIM),)),
        (FIRST._replace(number=1), ()),
        (BlockEnded(S, 0, "poor"), ()),
        (BlockEnded(S, 2, "unequal"), (Notice(DIFFERS, "error"),)),
    ],
)
def test_what_is_told_of_a_block(ended: BlockEnded, notices: tuple[Notice, ...]) -> None:
    assert (*block_notices(Distiller(SCHEDULE, 2, fresh_nonce), (ended,)),) == notices


def test_where_blocks_cannot_be_extracted_it_is_told_once_and_why() -> None:
    keys = Distiller(SCHEDULE, 2, fresh_nonce)
    told = Notice("no key is made from here on: disk", "error")
    assert [*extraction_done(keys, ExtractionFailed("disk"))] == [told]
    assert keys.status_fields()["keys_refused"] == "disk"
