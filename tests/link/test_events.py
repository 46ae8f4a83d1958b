"""Each event as the line that stands in a trace: readers of old traces count on every name."""

from typing import Any

import pytest

from protocol.agreement import AgreementResult
from protocol.box_observer import Box
from protocol.link.distiller import BlockEnded, Distiller
from protocol.link.effects import Notice
from protocol.link.events import (
    Alarm,
    AttackBegan,
    Event,
    Interrupted,
    Missed,
    Reason,
    SessionBegan,
    Timing,
    lines,
)
from protocol.link.key_events import Appearances, block_notices, extraction_done
from protocol.link.session import CountedTransition, Truth
from protocol.messages import SendCommand
from protocol.secret.blocks import ExtractionFailed, Schedule
from protocol.secret.bound import Assumption
from runtime.chance import fresh_nonce

S = "1" * 16
STEP: dict[str, Any] = {"session": S, "k": 3, "x": (1.0,), "u": (2.0,), "x_next": (3.5,)}
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
CENTRES = ((3.0,), (5.0,))
BOX = Box((0.5,), (1.5,))
COMMAND = SendCommand(id="m1", payload=b"a")
ATTACK = {"kind": "ghost", "at": "sensor", "onset": 7, "gain": 2.0}


@pytest.mark.parametrize(
    ("event", "line"),
    [
        (SessionBegan(None, "lost"), {"event": "session", "session": None, "reason": "lost"}),
        (TRANSITION, TOLD),
        (TRANSITION._replace(predictions=CENTRES), {**TOLD, "predictions": CENTRES}),
        (TRANSITION._replace(coin=0, u=(2.0,)), {**TOLD, "coin": 0, "u": (2.0,)}),
        (
            TRANSITION._replace(verdict=TRANSITION.verdict._replace(box=BOX)),
            {**TOLD, "box": BOX},
        ),
        (AttackBegan(ATTACK), {"event": "attack", **ATTACK}),
        (Missed(**STEP), {"event": "missed", **STEP}),
        (
            Missed(**STEP, truth=Truth((7.0,), (8.0,), "it was killed")),
            {
                "event": "missed",
                **STEP,
                "true_x_next": (7.0,),
                "true_u": (8.0,),
                "attack_failed": "it was killed",
            },
        ),
        (
            Interrupted(**STEP),
            {"event": "interrupted", **STEP, "candidates": (), "coin": -1},
        ),
        (
            Timing(9, 5, (0.1, 0.2, 0.3), (0.4, 0.5, 0.6), 1),
            {
                "event": "timing",
                "k": 9,
                "steps": 5,
                "sampled_late_s": (0.1, 0.2, 0.3),
                "actuated_after_s": (0.4, 0.5, 0.6),
                "overruns": 1,
            },
        ),
        (COMMAND, {"event": "sent", "id": "m1", "payload": "YQ=="}),
        (Appearances(S, 4, 2), {"event": "appearances", "session": S, "k": 4, "times": 2}),
        (
            BlockEnded(S, 1, "confirmed", 5),
            {"event": "block", "session": S, "number": 1, "what": "confirmed", "keys": 5},
        ),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, tuple) else "",
)
def test_an_event_is_its_line(event: Event, line: dict[str, Any]) -> None:
    assert event.as_event() == line
    assert lines(event) == (line,)


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


@pytest.mark.parametrize("at", ["sensor", "bus", "actuator"])
def test_an_attack_is_told_with_its_kind_place_and_onset(at: str) -> None:
    words = AttackBegan(ATTACK | {"at": at}).sentence().split()
    assert {"ghost", at, "7"} <= set(words)


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
