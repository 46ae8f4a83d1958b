"""The checks of the key stream and of alarms, by code of their own."""

from collections import deque
from typing import Final

import numpy as np

from wyner.runs.check.base import EDGE, Check, Counter
from wyner.runs.check.evidence import Evidence, Part
from wyner.runs.check.records import AlarmLine, BlockLine, OtherLine, TracedTransition, Walked

PREDICTED: Final = 1e-9
"""Relative: an expected state is a sum of products in an order of its own."""

WORDS_OF_A_KEY: Final = 8
DIGITS_OF_A_WORD: Final = 32
"""Bits of a word: no base gives more digits than that."""


class KeyStream(Check):
    """Digits serve once and in order, of blocks that both ends have confirmed, alike at both."""

    name = "key-stream"
    source = "rule 11"
    says = "digits of confirmed blocks serve in order, none twice, and alike at both ends"
    of = "offers"
    needs = ("plant",)

    def __init__(self, evidence: Evidence, counter: Counter) -> None:
        super().__init__(evidence, counter)
        rules = evidence.rules
        self._digits = rules.digits
        self._keyed, self._sealed = rules.keyed, rules.scheme.from_stream
        self._session = ""
        self._after = (-1, 0)
        self._keys: dict[int, int] = {}
        self._named: dict[str, tuple[int, tuple[int, int]]] = {}
        self._served = self._without = 0

    @classmethod
    def skipped(cls, evidence: Evidence) -> str:
        if not evidence.rules.digits:
            return "nothing uses the key stream"
        return super().skipped(evidence)

    def feed(self, part: Part) -> None:
        for item in part.plant:
            if isinstance(item, OtherLine) and isinstance(item.line, BlockLine):
                self._begin(item.line.session)
                if item.line.what == "confirmed":
                    self._keys[item.line.number] = item.line.keys
        for plant, controller in part.pairs:
            if plant is None:
                continue
            t = plant.t
            self._begin(t.session)
            self._served += t.keyed
            self._without += not t.keyed
            text = self._wrong(t, None if controller is None else controller.t)
            self.counter.count(not text, t.session, t.j, t.k, text)
        for seen in part.seen:
            if seen.topic == "offer":
                text = self._position(seen.session, seen.k, seen.message)
                self.counter.count(not text, seen.session, -1, seen.k, f"{seen.where}: {text}")

    def _begin(self, session: str) -> None:
        if session != self._session:
            self._session, self._after, self._keys = session, (-1, 0), {}

    def _wrong(self, t: TracedTransition, other: TracedTransition | None) -> str:
        """What is wrong with a transition's digits; the controller's trace tells the same."""
        if self._sealed and (t.role == "message") != t.keyed:
            return f"role {t.role}, and keyed is {t.keyed}"
        if t.digits is None:
            return "keyed, and the offer named no digits" if t.keyed else ""
        block, at = t.digits
        if (block, at) < self._after:
            return f"position {t.digits} is not beyond {self._after}"
        self._after = block, at + self._digits
        if block not in self._keys and self._known():
            return f"position {t.digits}: block {block} was not confirmed"
        most = self._keys.get(block, 1 << 30) * WORDS_OF_A_KEY * DIGITS_OF_A_WORD
        if at + self._digits > most:
            return f"position {t.digits}: block {block} has no such digit"
        if other is not None and self._keyed and other.expected not in (-1, t.coin):
            return f"the plant's coin was {t.coin}, the controller expected {other.expected}"
        return ""

    def _known(self) -> bool:
        """Whether the plant's trace is there from the beginning of its session."""
        plant = self.evidence.plant
        return plant is not None and not plant.gone and not plant.behind

    def _position(self, session: str, k: int, message: dict[str, object]) -> str:
        """What is wrong with the position that an offer names: each new one names a later one."""
        block, at = message.get("stream_block"), message.get("stream_at")
        if not isinstance(block, int) or not isinstance(at, int):
            return "an offer without a position"
        if block < 0:
            return ""
        known = self._named.get(session)
        self._named[session] = k, (block, at)
        if known is None or (known[0] == k and known[1] == (block, at)):
            return ""
        before = known[1][0], known[1][1] + self._digits
        if known[0] == k or (k > known[0] and (block, at) < before):
            return f"position {(block, at)}, and step {known[0]} had {known[1]}"
        return ""

    def finish(self) -> None:
        self.counter.note = f"{self._served} transitions had digits, {self._without} had none"


class Alarms(Check):
    """Every alarm is right and none is missing."""

    name = "alarms"
    source = "rule 12"
    says = "an alarm is told where its test failed, and nowhere else"
    of = "tests"
    needs = ("controller",)

    def __init__(self, evidence: Evidence, counter: Counter) -> None:
        super().__init__(evidence, counter)
        self._rule = evidence.rules.alarm_rule
        self._session = ""
        self._tests: deque[bool] = deque(maxlen=self._rule.window)
        self._known = True
        self._last: TracedTransition | None = None
        self._due: dict[tuple[str, int], tuple[TracedTransition, str]] = {}
        self._keyed = evidence.rules.keyed
        self._share, self._burst = evidence.rules.watch
        self._sum: float | None = None
        self._seen: set[tuple[str, int]] = set()

    def feed(self, part: Part) -> None:
        for item in part.controller:
            if isinstance(item, Walked):
                self._tested(item.t)
            elif isinstance(item, OtherLine) and isinstance(item.line, AlarmLine):
                self._alarmed(item.line)

    def _tested(self, t: TracedTransition) -> None:
        if self._last is None:
            assert self.evidence.controller is not None
            self._known = self.evidence.controller.gone == 0
        elif t.session != self._last.session:
            self._known = True
        if t.session != self._session:
            self._session = t.session
            self._tests.clear()
        self._last = t
        explained = [g <= 1 + EDGE for g in t.gauges]
        holds = any(explained)
        if t.expected != -1:
            inside = 0 <= t.expected < len(explained)
            text = f"expected: got {t.expected}, expected a candidate"
            self.counter.count(inside and t.keyed, t.session, t.j, t.k, text)
            holds = inside and explained[t.expected]
        else:
            self.counter.count(True, t.session, t.j, t.k)
        refused = self._keyed and t.digits is not None and not t.keyed
        self._tests.append(not holds or refused)
        reason = ""
        if self._tests[-1] and sum(self._tests) >= self._rule.failures:
            reason = "digits refused" if holds else "unexplained"
            reason = "another candidate" if not holds and t.expected != -1 else reason
        if self._keyed and self._unwatched(watched=t.expected != -1):
            reason = reason or "unwatched"
        if reason:
            self._due[t.session, t.j] = t, reason

    def _unwatched(self, *, watched: bool) -> bool:
        """Whether too many steps had no digit: their cumulative sum, once there were keys."""
        if self._sum is None:
            self._sum = 0.0 if watched else None
            return False
        self._sum = max(0.0, self._sum - self._share + (0.0 if watched else 1.0))
        over = self._sum > self._burst
        self._sum = 0.0 if over else self._sum
        return over

    def _alarmed(self, line: AlarmLine) -> None:
        due = self._due.get((line.session, line.j))
        where = line.session, line.j, line.k
        if due is None:
            assert self.evidence.controller is not None
            spared = self.evidence.controller.behind or not self._known
            self.counter.count(bool(spared), *where, "an alarm, and the test did not fail")
            return
        text = self._unlike(line, *due)
        self.counter.count(not text, *where, text)
        self._seen.add((line.session, line.j))

    def _unlike(self, line: AlarmLine, t: TracedTransition, reason: str) -> str:
        if (line.k, line.reading) != (t.k, t.x_next):
            return f"the alarm is of step {line.k}, {line.reading}; read was {t.x_next} at {t.k}"
        nearest = min(range(len(t.gauges)), key=t.gauges.__getitem__)
        candidate = t.expected if t.expected != -1 else nearest
        if line.reason != reason:
            return f"the alarm says {line.reason!r}, the test {reason!r}"
        if line.candidate != candidate:
            return f"the alarm expects candidate {line.candidate}, the test candidate {candidate}"
        if line.gauge != t.gauges[candidate]:
            return f"the alarm's gauge is {line.gauge}, recomputed {t.gauges[candidate]}"
        scenario = self.evidence.scenario
        centre = list(t.predictions[candidate]) if t.predictions else []
        if not centre:
            A, B = np.array(scenario.A), np.array(scenario.B)
            centre = (A @ np.array(t.x) + B @ np.array(t.candidates[candidate])).tolist()
        near = len(line.expected) == len(centre) and all(
            abs(p - q) <= PREDICTED * max(1.0, abs(q))
            for p, q in zip(line.expected, centre, strict=True)
        )
        return (
            "" if near else f"the alarm expects {line.expected}, f_c of its candidate is {centre}"
        )

    def finish(self) -> None:
        controller = self.evidence.controller
        assert controller is not None
        for at, (t, _) in self._due.items():
            if at in self._seen:
                continue
            cut_off = t is self._last and not controller.ended
            spared = cut_off or not self._known or controller.behind > 0
            self.counter.count(
                spared,
                t.session,
                t.j,
                t.k,
                "no alarm is told",
            )
        self.counter.note = f"{len(self._seen)} alarms"
