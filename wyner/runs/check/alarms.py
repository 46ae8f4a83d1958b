"""Every alarm is right, and none is missing."""

from typing import Any, NamedTuple

from controller_service.alarms import alarm_of, first, session_ended, tested
from protocol.agreement import NO_SYMBOL, AgreementResult
from protocol.box_observer import Box
from protocol.link.events import Alarm, PowerFailed, SessionBegan
from protocol.link.records import AlarmRecord
from protocol.link.session import CountedTransition, Rules
from protocol.messages import Measurement
from protocol.secret.stream import Position
from wyner.runs.check.evidence import Evidence, Finding, Findings
from wyner.runs.lines import OtherLine
from wyner.runs.trace import Trace

COLUMNS = ("session", "j", "k", "gauges", "expected", "keyed", "x", "candidates", "x_next")
MORE = ("block", "box", "predictions")
"""Columns that a test sees; the last where there are any."""


def alarms(e: Evidence, trace: Trace) -> Findings:
    """An alarm is told where its test failed, and nowhere else."""
    names = (*COLUMNS, *(name for name in MORE if name in (trace.rows.dtype.names or ())))
    rules, record, newest = e.rules, AlarmRecord(), None
    t: dict[str, Any] | None = None
    known = trace.gone == 0  # of a cut trace, once another session has begun
    lost = False  # after a power failure nobody knows how many steps had no digit
    due: dict[tuple[str, int], _Due] = {}
    for row, item in trace.walk(*names):
        if item is None:
            before, t = t, dict(zip(names, row, strict=True))
            if t["j"] < 0:
                continue
            session, k = trace.sessions[t["session"]], t["k"]
            if before is None or before["session"] != t["session"]:
                known, record = known or before is not None, record._replace(failed=0)
            if t["expected"] != NO_SYMBOL and not t["keyed"]:
                text = f"expected: got {t['expected']}, and no digits served"
                yield Finding("alarms", session, k, text)
            if first(rules, record).reason and known and not lost:
                text = "too many steps had no digit before, and no alarm is told"
                yield Finding("alarms", session, k, text)
            transition = _made(session, t)
            record, _, reason = tested(rules, record, transition)
            if reason:
                sure = known and not (lost and reason == "unwatched")
                due[session, t["j"]] = _Due(rules, transition, reason, sure)
        elif not isinstance(item, OtherLine):
            continue
        elif isinstance(item.line, PowerFailed):
            lost = True
            if t is not None:  # its alarm may be lost
                due.pop((trace.sessions[t["session"]], t["j"]), None)
        elif isinstance(item.line, SessionBegan):
            if item.line.session not in (None, newest):
                newest, record = item.line.session, session_ended(rules, record)
        elif isinstance(item.line, Alarm):
            line = item.line
            unsure = trace.behind or not known or (lost and line.reason == "unwatched")
            told = due.pop((line.session, line.j), None)
            text = ""
            if line.j < 0:
                right = line.reason == "unwatched" and (first(rules, record).reason or item.again)
                text = "" if right or unsure or lost else "an alarm before its time"
            elif told is not None:
                text = told.unlike(line)
            elif not unsure:
                text = "an alarm, and the test did not fail"
            if text:
                yield Finding("alarms", line.session, line.k, text)
            if line.j < 0 or (lost and line.reason == "unwatched"):
                record, lost = record._replace(unwatched=0.0), False
    for (session, j), told in due.items():
        is_last = t is not None and (trace.sessions[t["session"]], t["j"]) == (session, j)
        if told.sure and not trace.behind and (trace.ended or not is_last):
            text = "its test failed, and no alarm is told"
            yield Finding("alarms", session, told.transition.k, text)


class _Due(NamedTuple):
    """A transition whose test failed, and whether that is sure."""

    rules: Rules
    transition: CountedTransition
    reason: Any
    sure: bool

    def unlike(self, line: Alarm) -> str:
        """In what an alarm is not the one that is due; empty where it is."""
        t = self.transition
        read = Measurement.model_construct(
            session=t.session, k=t.k + 1, x=t.x_next, applied_k=t.k, x_after=t.x_next
        )
        due = alarm_of(self.rules, read, t, self.reason)
        return "" if line == due else f"the alarm says {tuple(line)}, the test {tuple(due)}"


def _made(session: str, t: dict[str, Any]) -> CountedTransition:
    """The transition of a row, as far as a test sees it."""
    block, expected = t.get("block", -1), t["expected"]
    return CountedTransition(
        session=session,
        j=t["j"],
        k=t["k"],
        x=tuple(t["x"]),
        candidates=tuple(map(tuple, t["candidates"])),
        cipher=0,
        x_next=tuple(t["x_next"]),
        role="test",
        verdict=AgreementResult(
            tuple(t["gauges"]),
            NO_SYMBOL,
            box=Box(*map(tuple, t["box"])) if "box" in t else None,
        ),
        symbol=NO_SYMBOL,
        key=NO_SYMBOL,
        message_symbol=NO_SYMBOL,
        p=0,
        s=0,
        tested=True,
        predictions=tuple(map(tuple, t.get("predictions", ()))),
        digits=None if block < 0 else Position(block, 0),
        served=() if expected == NO_SYMBOL else (expected,),
        expected=expected,
    )
