"""The keys' clauses: the agreement test, the scheme, both ends in step."""

from collections.abc import Sequence
from dataclasses import fields
from operator import attrgetter
from typing import Final

from protocol.agreement import NO_SYMBOL
from protocol.schemes.base import decrypt
from wyner.runs.check.attacked import Labels
from wyner.runs.check.clause import EDGE, Judging, Tally, may_leave, need
from wyner.runs.check.evidence import Evidence
from wyner.runs.check.paper import ROUNDING, Automata, Line, f_c, key_symbols, scale
from wyner.runs.check.records import TracedTransition, Walked

_Known = dict[tuple[object, ...], tuple[set[int], list[float]]]

KNOWN: Final = 8192
"""Transitions of which one end's result is kept for the other."""


class _Opinion:
    """What the paper says of one end's trace, transition by transition."""

    def __init__(self, e: Evidence, side: str, known: _Known) -> None:
        self._known = known
        self._s = e.scenario
        self._linear = not e.rules.predicted
        self._size = e.rules.size
        self._D_c = tuple(zip(*e.scenario.defender.disturbance.rows(), strict=True))
        self._D_e = tuple(zip(*e.scenario.eavesdropper_set.rows(), strict=True))
        self._leaves = may_leave(e)
        self._reader = e.plant if side == "plant" else e.controller
        self._session = ""
        self._automata = Automata(self._size)
        self.labels = Labels()

    def _of_numbers(self, t: TracedTransition) -> tuple[set[int], list[float]]:
        """The keys that the raw numbers allow, and how far from each centre x(k+1) is.

        Of the same numbers at both ends it is worked out once.
        """
        numbers = t.x, t.candidates, t.predictions, t.x_next
        found = self._known.get(numbers)
        if found is None:
            centres: Sequence[Sequence[float]] = t.predictions
            if self._linear:
                centres = [f_c(self._s.A, self._s.B, t.x, u) for u in t.candidates]
            reached = [scale(self._D_c, t.x_next, c) for c in centres]
            found = key_symbols(reached, [scale(self._D_e, t.x_next, c) for c in centres]), reached
            if len(self._known) >= KNOWN:
                self._known.clear()
            self._known[numbers] = found
        return found

    def wrong(self, t: TracedTransition) -> str:
        """What the paper says otherwise; empty where it says the same."""
        if t.session != self._session:
            cut = None if self._session or self._reader is None else self._reader.cut
            p = cut.p if cut is not None and cut.session == t.session else 0
            always = self._s.secrecy.scheme == "pipelined"
            self._session = t.session
            self._automata = Automata(self._size, tests_always=always, p=p)
        keys, reached = self._of_numbers(t)
        expected = self._automata.step(t.cipher, t.symbol if t.symbol in keys else min(keys))
        found = Line(t.role, t.key, t.message_symbol, t.p, t.s, t.symbol)
        if found != expected:
            self._automata.s, self._automata.key, self._automata.p = t.s, t.symbol, t.p
            return f"(role, key, m, p, s, symbol) is {tuple(found)}, Fig. 5 gives {tuple(expected)}"
        if t.coin is None:
            return ""
        if t.u != t.candidates[t.coin]:
            return f"applied {t.u}, (15) gives candidate b_r = {t.coin}"
        inside = self._leaves or self.labels.lies(t.k) or reached[t.coin] <= 1 + ROUNDING
        return "" if inside else f"x(k+1) is not in Reach^c of candidate b_r = {t.coin}, (14)"


def paper(e: Evidence, tally: Tally) -> Judging:
    """Figs. 5 and 6 and their equations, by code that shares nothing with the ends."""
    if e.scenario.secrecy.scheme not in ("switched", "pipelined"):
        tally.skipped = f"{e.scenario.secrecy.scheme} is a scheme of its own, not the paper's"
        return
    known: _Known = {}
    opinions = {side: _Opinion(e, side, known) for side, _ in e.readers()}
    while (part := (yield)) is not None:
        for side, items in part.sides():
            for item in items:
                opinions[side].labels.step(item)
                if isinstance(item, Walked):
                    t = item.t
                    text = opinions[side].wrong(t)
                    tally.count(not text, t.session, t.j, t.k, f"{side}: {text}")


def agreement(_e: Evidence, tally: Tally) -> Judging:
    """Equations (20) and (21), recomputed from the raw numbers."""
    agreed = 0
    while (part := (yield)) is not None:
        for name, items in part.sides():
            for item in items:
                if not isinstance(item, Walked):
                    continue
                t, verdict, carry, _ = item
                holds = t.symbol == carry.agreed and t.gauges == verdict.gauges
                text = ""
                if t.symbol != carry.agreed:
                    text = f"{name}'s verdict is {t.symbol}, recomputed it is {carry.agreed}"
                elif not holds:
                    text = f"{name}'s gauges are {t.gauges}, recomputed {verdict.gauges}"
                tally.count(holds, t.session, t.j, t.k, text)
                agreed += name == "plant" and carry.agreed != NO_SYMBOL
    tally.note = f"{agreed} keys agreed"


def coin(e: Evidence, tally: Tally) -> Judging:
    """Equation (22): the key is b_r."""
    if not need(tally, plant_trace=e.plant):
        return
    left = spoofed = 0
    leaves, labels = may_leave(e), Labels()
    while (part := (yield)) is not None:
        for item in part.plant:
            labels.step(item)
            if not isinstance(item, Walked) or item.t.symbol == NO_SYMBOL:
                continue
            t = item.t
            if labels.lies(t.k):
                spoofed += t.symbol != t.coin
                continue
            assert t.coin is not None
            outside = leaves and t.gauges[t.coin] > 1 + EDGE
            left += outside and t.symbol != t.coin
            text = f"agreed on {t.symbol}, the plant's coin was {t.coin}"
            tally.count(t.symbol == t.coin or outside, t.session, t.j, t.k, text)
    if left:
        tally.note = f"{left} unlike the coin, each with a disturbance outside D_c"
    if spoofed:
        tally.note = f"{spoofed} unlike the coin under attack"


def _scheme(e: Evidence, side: str, tally: Tally) -> Judging:
    session, p, sessions = "", 0, 0
    size = e.rules.size
    reader = e.plant if side == "plant" else e.controller
    while (part := (yield)) is not None:
        for item in part.plant if side == "plant" else part.controller:
            if not sessions and reader is not None and (cut := reader.cut) is not None:
                session, p, sessions = cut.session, cut.p, 1
            if not isinstance(item, Walked):
                continue
            t, _, (agreed, pad), s = item
            if t.session != session:
                session, p = t.session, 0
                sessions += 1
            role, recovered = "test", NO_SYMBOL
            if pad != NO_SYMBOL:
                role, recovered = "message", decrypt(t.cipher, pad, size)
                p += 1
            expected = (role, pad, recovered, p, s, agreed)
            got = (t.role, t.key, t.message_symbol, t.p, t.s, t.symbol)
            holds = got == expected
            text = ""
            if not holds:
                text = f"(role, key, m, p, s, symbol) is {got}, the scheme says {expected}"
            if not tally.count(holds, t.session, t.j, t.k, text):
                p = t.p
    tally.note = f"sessions: {sessions}"


def sender(e: Evidence, tally: Tally) -> Judging:
    """The scheme over the controller's trace."""
    if need(tally, controller_trace=e.controller):
        yield from _scheme(e, "controller", tally)


def receiver(e: Evidence, tally: Tally) -> Judging:
    """The scheme over the plant's trace."""
    if need(tally, plant_trace=e.plant):
        yield from _scheme(e, "plant", tally)


PLANTS_OWN: Final = ("coin", "u", "true_x_next", "true_u", "attack_failed")
_SHARED: Final = tuple(f.name for f in fields(TracedTransition) if f.name not in PLANTS_OWN)
_shared: Final = attrgetter(*_SHARED)


def in_step(e: Evidence, tally: Tally) -> Judging:
    """Both traces agree; the controller's may lack the last transition of a session."""
    if not need(tally, plant_trace=e.plant, controller_trace=e.controller):
        return
    ahead = 0
    lacking: TracedTransition | None = None  # of this session, at the controller
    while (part := (yield)) is not None:
        for plant, controller in part.pairs:
            if plant is None:
                assert controller is not None
                t = controller.t
                text = "the plant's trace does not have this transition"
                tally.count(False, t.session, t.j, t.k, text)
                continue
            a = plant.t
            if lacking is not None and lacking.session == a.session:
                text = "the controller has not counted this one, but the plant goes on"
                tally.fail(lacking.session, lacking.j, lacking.k, text)
                lacking = None
            if controller is None:
                lacking = a
                ahead += 1
                continue
            b = controller.t
            unlike = []
            text = ""
            if _shared(a) != _shared(b):
                unlike = [name for name in _SHARED if getattr(a, name) != getattr(b, name)]
                mine, other = getattr(a, unlike[0]), getattr(b, unlike[0])
                text = f"{', '.join(unlike)}: the plant has {mine}, the controller {other}"
            tally.count(not unlike, a.session, a.j, a.k, text)
    tally.note = f"{ahead} not yet counted by the controller"
