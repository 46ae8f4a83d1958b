"""Replay: each end's steps through the pure functions that both ends are made of."""

from typing import Any, Final

from protocol.agreement import NO_SYMBOL
from protocol.box_observer import Box, Estimate
from protocol.link.fallback import Fallback
from protocol.schemes.base import decrypt
from protocol.vectors import Vector
from wyner.runs.check.evidence import Evidence, Finding, Findings
from wyner.runs.lines import INTERRUPTED, Again, TracedTransition
from wyner.runs.trace import Rows, Trace

COLUMNS: Final = (
    "kind", "session", "j", "k", "x", "candidates", "x_next", "gauges", "cipher", "message", "key",
    "message_symbol", "p", "s", "symbol", "keyed",
)  # fmt: skip

TRUTH: Final = ("true_x_next", "true_u", "attack_failed")
"""What no journal holds."""


def replay(e: Evidence) -> Findings:
    """Verdict, role, keys, symbols and state of every transition, and a missed step's input."""
    for trace in e.ends():
        yield from _Replay(e, trace).findings()
        for _, item in trace.notes:
            if isinstance(item, Again):
                yield from _written_twice(trace, item)


def _written_twice(trace: Trace, item: Again) -> Findings:
    before, after = item.before, item.after
    unlike = [
        name
        for name in TracedTransition.__dataclass_fields__
        if name not in TRUTH and getattr(before, name) != getattr(after, name)
    ]
    if unlike:
        text = f"{trace.side}'s trace: written twice, with another {', '.join(unlike)}"
        yield Finding("replay", after.session, after.k, text)


class _Replay:
    """One end's steps, one after another."""

    def __init__(self, e: Evidence, trace: Trace) -> None:
        self._trace, self._rules = trace, e.rules
        self._fallback = Fallback.of(e.scenario)
        # A device is told of the fallback once a step is over: the input in force stood until then.
        self._may_stand = e.scenario.plant.kind == "python"
        self._session, self._state = -1, e.rules.scheme.initial
        self._p, self._k = 0, -1
        self._fresh: list[int] = []  # keys that were agreed and have not served
        self._estimate: Estimate | None = None  # of the last transition, where outputs are read
        self._known = trace.cut is None
        self._u: Vector = (0.0,) * e.rules.inputs
        self._place = 0
        if trace.cut is not None:
            self._u = trace.cut.u or self._u
            if trace.sessions[:1] == [trace.cut.session]:
                self._session, self._p, self._k = 0, trace.cut.p, trace.cut.k

    def findings(self) -> Findings:
        """What does not follow."""
        plant = self._trace.side == "plant"
        names = (*COLUMNS, "coin" if plant else "expected")
        for rows in self._trace.chunks():
            inputs = rows["u"].tolist() if plant else [()] * len(rows)
            for i, row in enumerate(zip(*(rows[name].tolist() for name in names), strict=True)):
                u = tuple(inputs[i])
                if row[1] != self._session:
                    self._begin(row[1], row[3], u)
                found = self._missed(row, u) if row[0] else self._counted(rows, i, row)
                self._u, self._place = u, row[3] + 1
                for rule, text in found:
                    yield Finding(rule, self._trace.sessions[row[1]], row[3], text)

    def _begin(self, session: int, k: int, u: Vector) -> None:
        self._session, self._state, self._fresh = session, self._rules.scheme.initial, []
        self._p, self._k, self._estimate, self._known = 0, -1, None, True
        if k == 0:  # it began again, without a journal
            self._u = (0.0,) * self._rules.inputs
        elif k != self._place:  # its journal was an older copy, or lines are lost
            self._u = u

    def _counted(self, rows: Rows, i: int, row: tuple[Any, ...]) -> list[tuple[str, str]]:
        (_, _, _, k, x, candidates, x_next, gauges, cipher, message, key,
         symbol, p, s, agreed, keyed, _) = row  # fmt: skip
        side, rules, found = self._trace.side, self._rules, []
        predictions: Any = rows["predictions"][i].tolist() if rules.predicted else ()
        box = None
        if rules.outputs is not None:
            box = Box(*(tuple(edge) for edge in rows["box"][i].tolist()))
            if self._known:
                expected = rules.outputs.box(self._estimate, k - self._k - 1, tuple(x))
                if expected != box:
                    text = f"{side}: box {tuple(box)}, both ends have {tuple(expected)}"
                    found.append(("replay", text))
                    box = expected
        verdict = rules.judge(
            tuple(x), tuple(map(tuple, candidates)), tuple(map(tuple, predictions)), tuple(x_next),
            box,
        )  # fmt: skip
        self._estimate, self._known, self._k = verdict.estimate, True, k
        state, taken = self._state, verdict.symbol
        if rules.scheme.corrects and side == "plant":
            state, taken = rules.scheme.hear(state, cipher), row[-1]
        self._state, carry = rules.scheme.follow(state, taken)
        pad = carry.pad
        if rules.scheme.from_stream:
            pad = key if keyed else NO_SYMBOL
        carried = pad != NO_SYMBOL
        recovered = decrypt(cipher, pad, rules.size) if carried else NO_SYMBOL
        due = (carried, pad, recovered, self._p + carried, self._state[0], carry.agreed)
        got = (message, key, symbol, p, s, agreed)
        if got != due:
            text = f"{side}: (message, key, m, p, s, symbol) is {got}, recomputed {due}"
            found.append(("replay", text))
        if list(verdict.gauges) != gauges:
            text = f"{side}: gauges are {gauges}, recomputed {list(verdict.gauges)}"
            found.append(("replay", text))
        self._p = p
        if not (rules.scheme.from_stream or rules.scheme.corrects):
            found += self._served(message, key, agreed)
        return found

    def _served(self, message: bool, key: int, agreed: int) -> list[tuple[str, str]]:
        """Every key symbol serves one message symbol; a pad made of several spends them."""
        found = []
        if message and key in self._fresh:
            self._fresh.remove(key)
        elif message and len(self._fresh) > 1:
            self._fresh.clear()
        elif message:
            text = f"{self._trace.side}: key {key} serves, unused were {self._fresh or 'none'}"
            found.append(("once", text))
            self._fresh.clear()
        if agreed != NO_SYMBOL:
            self._fresh.append(agreed)
        return found

    def _missed(self, row: tuple[Any, ...], u: Vector) -> list[tuple[str, str]]:
        """A step without a counted offer has the fallback's input."""
        kind, _, _, k, x, candidates, *_, coin = row
        outputs, what = self._rules.outputs, "a missed step"
        if kind == INTERRUPTED:
            what = "an interrupted step"
            expected = self._u if coin == NO_SYMBOL else tuple(candidates[coin])
        elif outputs is not None:
            expected = outputs.instead(self._estimate, k - self._k - 1, self._u)
        else:
            expected = self._fallback.input(tuple(x), self._u)
        if u == expected or (kind != INTERRUPTED and self._may_stand and u == self._u):
            return []
        return [("replay", f"{what} applied {u}, expected {expected}")]
