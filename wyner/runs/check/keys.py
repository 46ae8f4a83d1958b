"""The keys' checks: the agreement test, the scheme, both ends in step."""

from collections.abc import Sequence
from dataclasses import fields
from operator import attrgetter
from typing import ClassVar, Final

import numpy as np

from protocol.agreement import NO_SYMBOL
from protocol.arrays import Array
from protocol.box_observer import BoxObserver
from protocol.link.records import Side
from protocol.schemes.base import decrypt
from wyner.runs.check.attacked import lies, rewrites
from wyner.runs.check.base import EDGE, Check, Counter, may_leave
from wyner.runs.check.evidence import Evidence, Part
from wyner.runs.check.paper import (
    ROUNDING,
    Automata,
    Line,
    f_c,
    key_symbols,
    output_scale,
    scale,
)
from wyner.runs.check.records import TracedTransition, Walked

TINY: Final = 1e-12
"""In place of alpha - 1 where alpha is 1: no two candidates are possible for her."""


class _Opinion:
    """What the paper says of one end's trace, in blocks of transitions."""

    def __init__(self, e: Evidence, side: str) -> None:
        self._s = e.scenario
        self._linear = not e.rules.predicted
        self._observer: BoxObserver | None = e.scenario.observer
        self._A, self._B = np.array(e.scenario.A), np.array(e.scenario.B)
        H, h = e.scenario.test_set.rows()
        self._D_c = np.array(H), np.array(h)
        self._noisy = e.scenario.defender.noise is not None
        if self._noisy:  # what is possible for her is said by the offer
            room = max(e.scenario.secrecy.alpha - 1, TINY)
            H, h = e.scenario.defender.disturbance.rows()
            self._room = np.array(H), room * np.array(h)
        H, h = e.scenario.eavesdropper_set.rows()
        self._D_e = np.array(H), np.array(h)
        self._leaves = may_leave(e)
        self._reader = e.plant if side == "plant" else e.controller
        self._session = ""
        self._automata = Automata(e.rules.size)

    def of(self, ts: Sequence[TracedTransition]) -> list[str]:
        """What the paper says otherwise of each; empty where it says the same."""
        x_next = np.array([t.x_next for t in ts])
        with np.errstate(over="ignore", invalid="ignore"):  # a damaged trace holds any number
            if self._observer is not None:
                return self._of_outputs(self._observer, ts, x_next)
            if self._linear:
                x, u = np.array([t.x for t in ts]), np.array([t.candidates for t in ts])
                predictions = f_c(self._A, self._B, x, u)
            else:
                predictions = np.array([t.predictions for t in ts])
            reached = scale(*self._D_c, x_next, predictions)
            hers = scale(*self._D_e, x_next, predictions)
            if self._noisy:
                hers = np.max(
                    [scale(*self._room, c, predictions) for c in predictions.swapaxes(0, 1)], axis=0
                )
            keys = key_symbols(reached, hers)
        return [self._wrong(*row) for row in zip(ts, keys.tolist(), reached.tolist(), strict=True)]

    def _of_outputs(
        self, o: BoxObserver, ts: Sequence[TracedTransition], y_next: Array
    ) -> list[str]:
        """The same where outputs alone are read, and the state is in a box."""
        A, B, C = np.array(o.A), np.array(o.B), np.array(o.C)
        u = np.array([t.candidates for t in ts])
        box, D_c, N = np.array([t.box for t in ts]), np.array(o.disturbance), np.array(o.noise)
        reached = output_scale(A, B, C, box, u, D_c, N, y_next)
        moved = u @ B.T
        hers = np.max([scale(*self._room, c, moved) for c in moved.swapaxes(0, 1)], axis=0)
        keys = key_symbols(reached, hers)
        rows = zip(ts, keys.tolist(), reached.tolist(), strict=True)
        return [self._wrong(*row) for row in rows]

    def _wrong(self, t: TracedTransition, keys: list[int], reached: list[float]) -> str:
        if t.session != self._session:
            cut = None if self._session or self._reader is None else self._reader.cut
            p = cut.p if cut is not None and cut.session == t.session else 0
            always = self._s.secrecy.scheme == "pipelined"
            self._session = t.session
            self._automata = Automata(self._automata.size, tests_always=always, p=p)
        expected = self._automata.step(t.cipher, t.symbol if t.symbol in keys else min(keys))
        found = Line(t.role, t.key, t.message_symbol, t.p, t.s, t.symbol)
        if found != expected:
            self._automata.s, self._automata.key, self._automata.p = t.s, t.symbol, t.p
            return f"(role, key, m, p, s, symbol) is {tuple(found)}, Fig. 5 gives {tuple(expected)}"
        if t.coin is None:
            return ""
        if t.u != t.candidates[t.coin]:
            return f"applied {t.u}, (15) gives candidate b_r = {t.coin}"
        attack = None if self._reader is None else self._reader.attack
        inside = self._leaves or lies(attack, t.k) or reached[t.coin] <= 1 + ROUNDING
        return "" if inside else f"x(k+1) is not in Reach^c of candidate b_r = {t.coin}, (14)"


class Paper(Check):
    """Figs. 5 and 6 and their equations, by code that shares nothing with the ends."""

    name = "paper"
    source = "Figs. 5, 6"
    says = "the paper's test and automata, written a second time, agree"
    of = "transitions"

    def __init__(self, evidence: Evidence, counter: Counter) -> None:
        super().__init__(evidence, counter)
        self._opinions = {side: _Opinion(evidence, side) for side, _ in evidence.readers()}

    @classmethod
    def skipped(cls, evidence: Evidence) -> str:
        scheme = evidence.scenario.secrecy.scheme
        if scheme in ("switched", "pipelined"):
            return ""
        return f"{scheme} is a scheme of its own, not the paper's"

    def feed(self, part: Part) -> None:
        for side, items in part.sides():
            ts = [item.t for item in items if isinstance(item, Walked)]
            if ts:
                for t, text in zip(ts, self._opinions[side].of(ts), strict=True):
                    self.counter.count(not text, t.session, t.j, t.k, f"{side}: {text}")


class Agreement(Check):
    """Equations (20) and (21), recomputed from the raw numbers."""

    name = "agreement"
    source = "(20), (21)"
    says = "both verdicts follow from x, the candidates and x(k+1)"
    of = "verdicts"

    def __init__(self, evidence: Evidence, counter: Counter) -> None:
        super().__init__(evidence, counter)
        self._agreed = 0

    def feed(self, part: Part) -> None:
        for name, items in part.sides():
            for item in items:
                if not isinstance(item, Walked):
                    continue
                t, verdict, carry, _ = item
                text = ""
                if t.symbol != carry.agreed:
                    text = f"{name}'s verdict is {t.symbol}, recomputed it is {carry.agreed}"
                elif t.gauges != verdict.gauges:
                    text = f"{name}'s gauges are {t.gauges}, recomputed {verdict.gauges}"
                self.counter.count(not text, t.session, t.j, t.k, text)
                self._agreed += name == "plant" and carry.agreed != NO_SYMBOL

    def finish(self) -> None:
        self.counter.note = f"{self._agreed} keys agreed"


class Coin(Check):
    """Equation (22): the key is b_r."""

    name = "coin"
    source = "(22)"
    says = "the agreed symbol is the plant's own coin"
    of = "keys"
    needs = ("plant",)

    def __init__(self, evidence: Evidence, counter: Counter) -> None:
        super().__init__(evidence, counter)
        self._left, self._leaves, self._spoofed = 0, may_leave(evidence), 0

    def feed(self, part: Part) -> None:
        assert self.evidence.plant is not None
        for item in part.plant:
            if not isinstance(item, Walked) or item.t.symbol == NO_SYMBOL:
                continue
            t = item.t
            if lies(self.evidence.plant.attack, t.k):
                self._spoofed += t.symbol != t.coin
                continue
            assert t.coin is not None
            outside = self._leaves and t.gauges[t.coin] > 1 + EDGE
            self._left += outside and t.symbol != t.coin
            text = f"agreed on {t.symbol}, the plant's coin was {t.coin}"
            self.counter.count(t.symbol == t.coin or outside, t.session, t.j, t.k, text)

    def finish(self) -> None:
        if self._left:
            self.counter.note = f"{self._left} unlike the coin, each with a disturbance outside D_c"
        if self._spoofed:
            self.counter.note = f"{self._spoofed} unlike the coin under attack"


class _Scheme(Check):
    """The scheme over one end's trace."""

    of = "transitions"
    side: ClassVar[Side]

    def __init__(self, evidence: Evidence, counter: Counter) -> None:
        super().__init__(evidence, counter)
        self._session, self._p, self._sessions = "", 0, 0
        self._reader = evidence.plant if self.side == "plant" else evidence.controller

    def feed(self, part: Part) -> None:
        size = self.evidence.rules.size
        for item in part.plant if self.side == "plant" else part.controller:
            if not self._sessions and self._reader is not None and self._reader.cut is not None:
                cut = self._reader.cut
                self._session, self._p, self._sessions = cut.session, cut.p, 1
            if not isinstance(item, Walked):
                continue
            t, _, (agreed, pad), s = item
            if t.session != self._session:
                self._session, self._p = t.session, 0
                self._sessions += 1
            if self.evidence.rules.scheme.from_stream:
                pad = t.key if t.keyed else NO_SYMBOL
            role, recovered = "test", NO_SYMBOL
            if pad != NO_SYMBOL:
                role, recovered = "message", decrypt(t.cipher, pad, size)
                self._p += 1
            expected = (role, pad, recovered, self._p, s, agreed)
            got = (t.role, t.key, t.message_symbol, t.p, t.s, t.symbol)
            text = ""
            if got != expected:
                text = f"(role, key, m, p, s, symbol) is {got}, the scheme says {expected}"
            if not self.counter.count(not text, t.session, t.j, t.k, text):
                self._p = t.p

    def finish(self) -> None:
        self.counter.note = f"sessions: {self._sessions}"


class Sender(_Scheme):
    """The scheme over the controller's trace."""

    name = "sender"
    source = "Figs. 5, 6a"
    says = "the scheme gives what the controller recorded"
    needs = ("controller",)
    side = "controller"


class Receiver(_Scheme):
    """The scheme over the plant's trace."""

    name = "receiver"
    source = "Figs. 5, 6b"
    says = "the scheme gives what the plant recorded"
    needs = ("plant",)
    side = "plant"


OWN: Final = ("coin", "u", "expected", "true_x_next", "true_u", "attack_failed")
"""What one end alone knows."""

_SHARED: Final = tuple(f.name for f in fields(TracedTransition) if f.name not in OWN)
_UNWRITTEN: Final = tuple(
    name for name in _SHARED if name not in ("x", "candidates", "x_next", "gauges", "predictions")
)
"""What an attack on the bus has no say in."""

_shared: Final = attrgetter(*_SHARED)


class InStep(Check):
    """Both traces agree; the controller's may lack the last transition of a session."""

    name = "in-step"
    source = "proposition 3"
    says = "both ends agree on every transition both have counted"
    of = "transitions"
    needs = ("plant", "controller")

    def __init__(self, evidence: Evidence, counter: Counter) -> None:
        super().__init__(evidence, counter)
        self._ahead = 0
        self._lacking: TracedTransition | None = None  # of this session, at the controller

    def feed(self, part: Part) -> None:
        for plant, controller in part.pairs:
            if plant is None:
                assert controller is not None
                t = controller.t
                text = "the plant's trace does not have this transition"
                self.counter.count(False, t.session, t.j, t.k, text)
                continue
            self._of_plant(plant.t, None if controller is None else controller.t)

    def _of_plant(self, a: TracedTransition, b: TracedTransition | None) -> None:
        lacking = self._lacking
        if lacking is not None and lacking.session == a.session:
            text = "the controller has not counted this one, but the plant goes on"
            self.counter.fail(lacking.session, lacking.j, lacking.k, text)
            self._lacking = None
        if b is None:
            self._lacking = a
            self._ahead += 1
            return
        text, names = "", _SHARED
        if _shared(a) != _shared(b):
            if self.evidence.plant is not None and rewrites(self.evidence.plant.attack, a.k):
                names = _UNWRITTEN
            unlike = [name for name in names if getattr(a, name) != getattr(b, name)]
            if unlike:
                mine, other = getattr(a, unlike[0]), getattr(b, unlike[0])
                text = f"{', '.join(unlike)}: the plant has {mine}, the controller {other}"
        self.counter.count(not text, a.session, a.j, a.k, text)

    def finish(self) -> None:
        self.counter.note = f"{self._ahead} not yet counted by the controller"
