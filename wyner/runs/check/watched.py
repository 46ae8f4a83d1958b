"""The checks of the keyed coin and of alarms, by code of their own."""

from collections import deque
from contextlib import ExitStack
from typing import Final, NamedTuple

import numpy as np

from protocol.secret.records import Side
from wyner.runs.check.base import EDGE, Check, Counter
from wyner.runs.check.evidence import Evidence, Part
from wyner.runs.check.key_blocks import FILES, open_store
from wyner.runs.check.records import AlarmLine, OtherLine, TracedTransition, Walked

WORDS: Final = 8
WORD: Final = 2**32

PREDICTED: Final = 1e-9
"""Relative: an expected state is a sum of products in an order of its own."""


def base_digits(key: bytes, size: int) -> list[int]:
    """The digits of a key: of each word of 32 bits as many as give the most in the mean.

    A word at or above the largest multiple of ``size`` to their number gives none.
    """
    choices = []
    number = 1
    while size**number <= WORD:
        multiple = WORD - WORD % size**number
        choices.append((number * multiple, -number, multiple))
        number += 1
    _, number, multiple = max(choices)
    found = []
    for word in range(WORDS):
        value = int(key[4 * word : 4 * word + 4].hex(), 16)
        if value < multiple:
            found += [value // size**place % size for place in range(-number)]
    return found


class _Served(NamedTuple):
    """What is known of a key: the step of its first digit, and the last step that it served."""

    first: int
    last: int


class KeyedCoins(Check):
    """Each keyed coin is the digit that belongs to its step, of a key of both ends."""

    name = "keyed-coin"
    source = "rule 12"
    says = "coins are digits of keys that both stores gave, in order, none twice"
    of = "coins"
    needs = ("plant",)

    def __init__(self, evidence: Evidence, counter: Counter) -> None:
        super().__init__(evidence, counter)
        self._served: dict[str, _Served] = {}
        self._key = ""
        self._watched = self._private = 0
        self._digits: dict[str, list[int]] = {}
        self._uses: dict[str, dict[str, str]] = {}
        with ExitStack() as stack:
            for side, name in FILES:
                self._read(side, name, stack)

    @classmethod
    def skipped(cls, evidence: Evidence) -> str:
        if not evidence.scenario.defence.keyed:
            return "the scenario keys no coin"
        return super().skipped(evidence)

    def _read(self, side: Side, name: str, stack: ExitStack) -> None:
        """The uses of a store's keys, and the digits of those whose bytes are left."""
        store = open_store(self.evidence, side, name, self.counter, stack)
        if store is None:
            return
        column = "use" if side == "controller" else "there"
        rows = store.rows(f"SELECT id, {column}, body FROM key WHERE {column} LIKE 'coin %'")
        self._uses[side] = {key: use for key, use, _ in rows}
        size = self.evidence.rules.size
        for key, _, body in rows:
            if body is not None and len(body) == 4 * WORDS:
                self._digits[key] = base_digits(bytes(body), size)

    def feed(self, part: Part) -> None:
        for plant, controller in part.pairs:
            if plant is None:
                continue
            t = plant.t
            if not t.coin_key:
                text = "" if t.coin_key == "" else "coin_key: expected one, as the coin is keyed"
                self.counter.count(not text, t.session, t.j, t.k, text)
                self._private += 1
                continue
            expected = -1 if controller is None else controller.t.expected
            self._watched += expected != -1
            text = self._wrong(t, t.coin_key, expected)
            self.counter.count(not text, t.session, t.j, t.k, text)

    def _wrong(self, t: TracedTransition, key: str, expected: int) -> str:
        before, self._served[key] = self._served.get(key), _Served(t.coin_from, t.k)
        if before is not None and key != self._key:
            return f"key {key} had been left for another one"
        self._key = key
        at = t.k - t.coin_from
        if at < 0 or t.coin_from < 0:
            return f"key {key} begins at step {t.coin_from}"
        if before is not None and before.first != t.coin_from:
            return f"key {key} begins at step {t.coin_from}, and began at {before.first}"
        if before is not None and t.k <= before.last:
            return f"key {key} had served step {before.last}"
        if expected not in (-1, t.coin):
            return f"the plant's coin was {t.coin}, the controller expected {expected}"
        found = self._digits.get(key)
        if found is not None and found[at : at + 1] != [t.coin]:
            return f"digit {at} of key {key} is not the coin {t.coin}"
        uses = [self._uses[side].get(key) for side in self._uses]
        named = f"coin {t.session} "
        if any(use is None or not use.startswith(named) for use in uses):
            return f"key {key} was given for {uses[0]}, not for this session's coin"
        both = " and for ".join(map(str, uses))
        return "" if len(set(uses)) < 2 else f"key {key} was given for {both}"

    def finish(self) -> None:
        self.counter.note = (
            f"{self._watched} watched, {self._private} private, of {len(self._served)} keys"
        )


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
        self._due: dict[tuple[str, int], TracedTransition] = {}
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
            text = f"expected: got {t.expected}, expected a candidate of key {t.coin_key!r}"
            self.counter.count(inside and bool(t.coin_key), t.session, t.j, t.k, text)
            holds = inside and explained[t.expected]
        else:
            self.counter.count(True, t.session, t.j, t.k)
        self._tests.append(not holds)
        if not holds and sum(self._tests) >= self._rule.failures:
            self._due[t.session, t.j] = t

    def _alarmed(self, line: AlarmLine) -> None:
        t = self._due.get((line.session, line.j))
        where = line.session, line.j, line.k
        if t is None:
            assert self.evidence.controller is not None
            spared = self.evidence.controller.behind or not self._known
            self.counter.count(bool(spared), *where, "an alarm, and the test did not fail")
            return
        text = self._unlike(line, t)
        self.counter.count(not text, *where, text)
        self._seen.add((line.session, line.j))

    def _unlike(self, line: AlarmLine, t: TracedTransition) -> str:
        if (line.k, line.reading) != (t.k, t.x_next):
            return f"the alarm is of step {line.k}, {line.reading}; read was {t.x_next} at {t.k}"
        nearest = min(range(len(t.gauges)), key=t.gauges.__getitem__)
        key, candidate = (t.coin_key or "", t.expected) if t.expected != -1 else ("", nearest)
        if (line.coin_key, line.candidate) != (key, candidate):
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
        for at, t in self._due.items():
            if at in self._seen:
                continue
            cut_off = t is self._last and not controller.ended
            spared = cut_off or not self._known or controller.behind > 0
            self.counter.count(spared, t.session, t.j, t.k, "its test failed, and no alarm is told")
        self.counter.note = f"{len(self._seen)} alarms"
