"""Replay: each end's steps through the pure functions that both ends are made of."""

from collections.abc import Iterator
from typing import Any, Final

from protocol.agreement import NO_SYMBOL
from protocol.box_observer import Box, Estimate
from protocol.link.fallback import Fallback
from protocol.schemes.base import decrypt
from protocol.vectors import Vector
from wyner.runs.check.evidence import Evidence, Finding, Findings, before, columns
from wyner.runs.lines import INTERRUPTED, Again, TracedTransition
from wyner.runs.trace import Rows, Trace

COLUMNS: Final = (
    "kind", "session", "k", "x", "candidates", "x_next", "gauges", "cipher", "message", "key",
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
    unlike = [
        name
        for name in TracedTransition.__dataclass_fields__
        if name not in TRUTH and getattr(item.before, name) != getattr(item.after, name)
    ]
    if unlike:
        text = f"{trace.side}'s trace: written twice, with another {', '.join(unlike)}"
        yield Finding("replay", item.after.session, item.after.k, text)


Wrong = Iterator[tuple[str, str]]
"""Rules, and what is wrong by them."""


class _Replay:
    """One end's steps, one after another."""

    def __init__(self, e: Evidence, trace: Trace) -> None:
        self._trace, self._rules = trace, e.rules
        self._fallback = Fallback.of(e.scenario)
        # A device is told of the fallback once a step is over: the input in force stood until then.
        self._may_stand = e.scenario.plant.kind == "python"
        self._u: Vector = ()
        self._place = 0
        self._begin(-1, 0, ())
        if trace.cut is not None:
            self._u, self._known = trace.cut.u or self._u, False
        if (cut := before(trace)) is not None:
            self._session, self._p, self._k = 0, cut.p, cut.k

    def findings(self) -> Findings:
        """What does not follow."""
        plant = self._trace.side == "plant"
        names = (*COLUMNS, "coin" if plant else "expected")
        for rows in self._trace.chunks():
            inputs = rows["u"].tolist() if plant else [()] * len(rows)
            for i, row in enumerate(zip(*columns(rows, *names), strict=True)):
                kind, session, k, u = row[0], row[1], row[2], tuple(inputs[i])
                if session != self._session:
                    self._begin(session, k, u)
                wrong = self._missed(row, u) if kind else self._counted(rows, i, row)
                where = self._trace.sessions[session], k
                for rule, text in wrong:
                    yield Finding(rule, *where, f"{self._trace.side}: {text}")
                self._u, self._place = u, k + 1

    def _begin(self, session: int, k: int, u: Vector) -> None:
        self._session, self._state = session, self._rules.scheme.initial
        self._fresh: list[int] = []  # keys that were agreed and have not served
        self._estimate: Estimate | None = None  # of the last transition, where outputs are read
        self._p, self._k, self._known = 0, -1, True
        if k == 0:  # it began again, without a journal
            self._u = (0.0,) * self._rules.inputs
        elif k != self._place:  # its journal was an older copy, or lines are lost
            self._u = u

    def _counted(self, rows: Rows, i: int, row: tuple[Any, ...]) -> Wrong:
        (_, _, k, x, candidates, x_next, gauges, cipher, message, key,
         symbol, p, s, agreed, keyed, coin) = row  # fmt: skip
        rules, scheme = self._rules, self._rules.scheme
        predictions: Any = rows["predictions"][i].tolist() if rules.predicted else ()
        box = None
        if rules.outputs is not None:
            box = Box(*(tuple(edge) for edge in rows["box"][i].tolist()))
            if self._known:
                due = rules.outputs.box(self._estimate, k - self._k - 1, tuple(x))
                if due != box:
                    yield "replay", f"box {tuple(box)}, both ends have {tuple(due)}"
                box = due
        verdict = rules.judge(
            tuple(x), tuple(map(tuple, candidates)), tuple(map(tuple, predictions)), tuple(x_next),
            box,
        )  # fmt: skip
        self._estimate, self._known, self._k = verdict.estimate, True, k
        state, taken = self._state, verdict.symbol
        if scheme.corrects and self._trace.side == "plant":
            state, taken = scheme.hear(state, cipher), coin
        self._state, carry = scheme.follow(state, taken)
        pad = carry.pad
        if scheme.from_stream:
            pad = key if keyed else NO_SYMBOL
        carried = pad != NO_SYMBOL
        recovered = decrypt(cipher, pad, rules.size) if carried else NO_SYMBOL
        made = (carried, pad, recovered, self._p + carried, self._state[0], carry.agreed)
        got, expected = (message, key, symbol, p, s, agreed, gauges), (*made, [*verdict.gauges])
        if got != expected:
            text = f"(message, key, m, p, s, symbol, gauges) is {got}, recomputed {expected}"
            yield "replay", text
        self._p = p
        if not (scheme.from_stream or scheme.corrects):
            yield from self._served(message, key, agreed)

    def _served(self, message: bool, key: int, agreed: int) -> Wrong:
        """Every key symbol serves one message symbol; a pad made of several spends them."""
        if message and key in self._fresh:
            self._fresh.remove(key)
        elif message:
            if len(self._fresh) < 2:
                yield "once", f"key {key} serves, unused were {self._fresh or 'none'}"
            self._fresh.clear()
        if agreed != NO_SYMBOL:
            self._fresh.append(agreed)

    def _missed(self, row: tuple[Any, ...], u: Vector) -> Wrong:
        """A step without a counted offer has the fallback's input."""
        kind, _, k, x, candidates, *_, coin = row
        outputs, stands = self._rules.outputs, self._may_stand and kind != INTERRUPTED
        if kind == INTERRUPTED:
            expected = self._u if coin == NO_SYMBOL else tuple(candidates[coin])
        elif outputs is not None:
            expected = outputs.instead(self._estimate, k - self._k - 1, self._u)
        else:
            expected = self._fallback.input(tuple(x), self._u)
        if u != expected and not (stands and u == self._u):
            what = "an interrupted" if kind == INTERRUPTED else "a missed"
            yield "replay", f"{what} step applied {u}, expected {expected}"
