"""Every alarm is right, and none is missing."""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from protocol.agreement import NO_SYMBOL
from protocol.defence.watch import NEVER
from protocol.link.session import Rules
from wyner.runs.check.evidence import EDGE, Evidence, Finding, Findings
from wyner.runs.lines import AlarmLine, OtherLine, PowerLine, SessionLine

PREDICTED: Final = 1e-9
"""Relative: an expected state is a sum of products in an order of its own."""

Numbers = list[float]


class Tested(NamedTuple):
    """A transition at the controller, in the columns that a test sees."""

    session: int
    j: int
    k: int
    gauges: Numbers
    expected: int
    keyed: bool
    x: Numbers
    candidates: list[Numbers]
    x_next: Numbers
    block: int = -1
    box: list[Numbers] | None = None
    predictions: list[Numbers] | None = None


def alarms(e: Evidence) -> Findings:
    """An alarm is told where its test failed, and nowhere else."""
    trace = e.controller
    if trace is None:
        return
    names = [name for name in Tested._fields if name in (trace.rows.dtype.names or ())]
    test = _Test(e.rules)
    t: Tested | None = None
    known = trace.gone == 0  # of a cut trace, once another session has begun
    lost = False  # after a power failure nobody knows how many steps had no digit
    due: dict[tuple[str, int], tuple[Tested, str, bool]] = {}
    for row, item in trace.walk(*names):
        if item is None:
            before, t = t, Tested(**dict(zip(names, row, strict=True)))
            if t.j < 0:
                continue
            known = known or (before is not None and before.session != t.session)
            if t.expected != NO_SYMBOL and not t.keyed:
                text = f"expected: got {t.expected}, and no digits served"
                yield Finding("alarms", trace.sessions[t.session], t.k, text)
            if test.over and known and not lost:
                text = "too many steps had no digit before, and no alarm is told"
                yield Finding("alarms", trace.sessions[t.session], t.k, text)
            if reason := test.failed(t):
                sure = known and not (lost and reason == "unwatched")
                due[trace.sessions[t.session], t.j] = t, reason, sure
        elif isinstance(item, OtherLine) and isinstance(item.line, PowerLine):
            lost = True
            if t is not None:  # its alarm may be lost
                due.pop((trace.sessions[t.session], t.j), None)
        elif isinstance(item, OtherLine) and isinstance(item.line, SessionLine):
            test.began(item.line.session)
        elif isinstance(item, OtherLine) and isinstance(item.line, AlarmLine):
            line = item.line
            if line.j < 0:
                told = line.reason == "unwatched" and (test.over or item.again)
                if not told and known and not lost and not trace.behind:
                    yield Finding("alarms", line.session, line.k, "an alarm before its time")
                test.total, lost = 0.0, False
                continue
            tested, reason, _ = due.pop((line.session, line.j), (None, "", False))
            if tested is not None:
                text = _unlike(e, line, tested, reason)
            else:
                unsure = trace.behind or not known or (lost and line.reason == "unwatched")
                text = "" if unsure else "an alarm, and the test did not fail"
            if text:
                yield Finding("alarms", line.session, line.k, text)
            if lost and line.reason == "unwatched":
                test.total, lost = 0.0, False
    for (session, _), (tested, _, sure) in due.items():
        cut_off = tested is t and not trace.ended
        if sure and not cut_off and not trace.behind:
            yield Finding("alarms", session, tested.k, "its test failed, and no alarm is told")


@dataclass
class _Test:
    """The rule that makes an alarm, from one transition to the next."""

    rules: Rules
    session: int = -1
    before: int = 0  # the tests that failed, as the rule remembers them
    total: float = NEVER
    newest: str | None = None

    def failed(self, t: Tested) -> str:
        """Why a transition makes an alarm; empty where it makes none."""
        rules = self.rules
        if t.session != self.session:
            self.session, self.before = t.session, 0
        explained = [g <= 1 + EDGE for g in t.gauges]
        watched = t.expected != NO_SYMBOL
        holds = explained[t.expected] if watched else any(explained)
        refused = rules.keyed and t.block >= 0 and not t.keyed
        alarm, self.before = rules.alarm_rule.test(self.before, failed=not holds or refused)
        reason = ""
        if alarm:
            reason = "digits refused" if holds else "unexplained"
            reason = "another candidate" if not holds and watched else reason
        if rules.keyed:
            self.total, too_many = rules.watch.after(self.total, watched=watched)
            reason = reason or ("unwatched" if too_many else "")
        return reason

    def began(self, session: str | None) -> None:
        """A session began: of the last step of the one before nobody has heard."""
        if session is None or session == self.newest:
            return
        self.newest = session
        if self.rules.keyed:
            self.total = self.rules.watch.unheard(self.total)

    @property
    def over(self) -> bool:
        """Whether the first reading of a session makes an alarm."""
        return self.total > self.rules.watch.burst


def _unlike(e: Evidence, line: AlarmLine, t: Tested, reason: str) -> str:
    """In what an alarm is not the one that is due."""
    nearest = min(range(len(t.gauges)), key=t.gauges.__getitem__)
    candidate = nearest if t.expected == NO_SYMBOL else t.expected
    told = (line.k, list(line.reading), line.reason, line.candidate)
    if told != (t.k, t.x_next, reason, candidate):
        return f"the alarm says {told}, the test {(t.k, t.x_next, reason, candidate)}"
    if line.gauge != t.gauges[candidate]:
        return f"the alarm's gauge is {line.gauge}, recomputed {t.gauges[candidate]}"
    A, B = np.array(e.scenario.A), np.array(e.scenario.B)
    x = np.array(t.x) if t.box is None else np.mean(t.box, axis=0)
    centre = A @ x + B @ np.array(t.candidates[candidate])
    if t.predictions is not None:
        centre = np.array(t.predictions[candidate])
    elif e.scenario.observer is not None:
        centre = np.array(e.scenario.observer.C) @ centre
    expected = np.array(line.expected)
    near = (
        expected.shape == centre.shape
        and (np.abs(expected - centre) <= PREDICTED * np.maximum(1.0, np.abs(centre))).all()
    )
    text = f"the alarm expects {line.expected}, f_c of its candidate is {centre.tolist()}"
    return "" if near else text
