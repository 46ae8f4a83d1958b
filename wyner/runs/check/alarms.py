"""Every alarm is right, and none is missing."""

from typing import Any, Final

from controller_service.alarms import alarm_of, first, session_ended, tested
from protocol.agreement import NO_SYMBOL, AgreementResult
from protocol.box_observer import Box
from protocol.link.events import Alarm, PowerFailed, SessionBegan
from protocol.link.records import AlarmRecord
from protocol.link.session import CountedTransition
from protocol.messages import Measurement
from protocol.secret.stream import Position
from wyner.runs.check.evidence import Evidence, Finding, Findings
from wyner.runs.lines import Break, OtherLine
from wyner.runs.trace import Trace

COLUMNS: Final = ("session", "j", "k", "gauges", "expected", "keyed", "x", "candidates", "x_next")
MORE: Final = ("block", "box", "predictions")
"""Columns that a test sees; the last where there are any."""

MISSING: Final = "its test failed, and no alarm is told"


def alarms(e: Evidence, trace: Trace) -> Findings:
    """An alarm is told where its test failed, and nowhere else."""
    names = (*COLUMNS, *(name for name in MORE if name in (trace.rows.dtype.names or ())))
    rules, record, newest, session = e.rules, AlarmRecord(), None, -1
    known = trace.gone == 0  # of a cut trace, once another session has begun
    lost = False  # after a power failure nobody knows how many steps had no digit
    due: Alarm | None = None
    sure = killed = False
    told: Alarm | None = None
    for row, item in trace.walk(*names):
        line, text = item.line if isinstance(item, OtherLine) else item, ""
        if line is None:
            if due is not None and sure:
                yield Finding("alarms", due.session, due.k, MISSING)
            t = dict(zip(names, row, strict=True))
            if t["session"] != session:
                known, record = known or session >= 0, record._replace(failed=0)
            session, due, killed = t["session"], None, False
            made = _made(trace.sessions[session], t)
            if made.served and not t["keyed"]:
                text = f"expected: got {made.expected}, and no digits served"
            elif first(rules, record).reason and known and not lost:
                text = "too many steps had no digit before, and no alarm is told"
            if text:
                yield Finding("alarms", made.session, made.k, text)
            record, _, reason = tested(rules, record, made)
            if reason:
                due = alarm_of(rules, _NO_READING, made, reason)
                sure = known and not trace.behind and not (lost and reason == "unwatched")
        elif isinstance(line, Break):
            killed = not line.ended
        elif isinstance(line, PowerFailed):
            lost, due = True, None  # its alarm may be lost
        elif isinstance(line, SessionBegan):
            if line.session not in (None, newest):
                newest, record = line.session, session_ended(rules, record)
        elif isinstance(line, Alarm) and not (killed and line == told):  # else it comes again
            unwatched, told = line.reason == "unwatched", line
            unsure = trace.behind or not known or (lost and unwatched)
            if line.j < 0:
                right = unwatched and first(rules, record).reason
                text = "" if right or unsure or lost else "an alarm before its time"
            elif due is not None and line[:3] == due[:3]:
                text = "" if line == due else f"the alarm says {tuple(line)}, the test {tuple(due)}"
                due = None
            elif not unsure:
                text = "an alarm, and the test did not fail"
            if text:
                yield Finding("alarms", line.session, line.k, text)
            if line.j < 0 or (lost and unwatched):
                record, lost = record._replace(unwatched=0.0), False
    if due is not None and sure and trace.ended:
        yield Finding("alarms", due.session, due.k, MISSING)


_NOTHING: Final = CountedTransition(
    "", -1, -1, (), (), 0, (), "test", AgreementResult((), NO_SYMBOL), NO_SYMBOL, NO_SYMBOL,
    NO_SYMBOL, 0, 0, tested=True,
)  # fmt: skip


_NO_READING: Final = Measurement.model_construct(session="", k=0, x=(), applied_k=0, x_after=())
"""What an alarm is made of where there is no transition."""


def _made(session: str, t: dict[str, Any]) -> CountedTransition:
    """The transition of a row, as far as a test sees it."""
    box = Box(*map(tuple, t["box"])) if "box" in t else None
    return _NOTHING._replace(
        session=session,
        j=t["j"],
        k=t["k"],
        x=tuple(t["x"]),
        candidates=tuple(map(tuple, t["candidates"])),
        x_next=tuple(t["x_next"]),
        verdict=AgreementResult(tuple(t["gauges"]), NO_SYMBOL, box=box),
        predictions=tuple(map(tuple, t.get("predictions", ()))),
        digits=None if t.get("block", -1) < 0 else Position(t["block"], 0),
        served=() if t["expected"] == NO_SYMBOL else (t["expected"],),
        expected=t["expected"],
    )
