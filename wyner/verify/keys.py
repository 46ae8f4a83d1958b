"""The keys' clauses: the agreement test, the scheme, both ends in step."""

from collections.abc import Iterator
from dataclasses import fields
from typing import Final, NamedTuple

from protocol.agreement import NO_SYMBOL, Verdict
from protocol.schemes.base import Carry, decrypt
from wyner.verify.clause import EDGE, Tally, may_leave, need, sides
from wyner.verify.evidence import Counted, Evidence


class Walked(NamedTuple):
    """A transition, its verdict from the raw numbers, and what the scheme makes of it."""

    t: Counted
    verdict: Verdict
    carry: Carry
    s: int


def walk(e: Evidence, transitions: list[Counted]) -> Iterator[Walked]:
    """One session's transitions in order, the scheme going on by the verdicts recomputed."""
    scheme = e.rules.scheme
    state = scheme.initial
    for t in transitions:
        verdict = e.rules.agreement.verdict(t.x, t.candidates, t.x_next)
        state, carry = scheme.advance(state, verdict.symbol)
        yield Walked(t, verdict, carry, state[0])


def agreement(e: Evidence, tally: Tally) -> None:
    """Equations (20) and (21), recomputed from the raw numbers."""
    agreed = 0
    for name, side in sides(e):
        for ts in side.sessions.values():
            for t, verdict, carry, _ in walk(e, ts):
                expected = carry.agreed
                holds = t.symbol == expected and t.gauges == verdict.gauges
                text = f"{name}'s verdict is {t.symbol}, recomputed it is {expected}"
                if t.symbol == expected:
                    text = f"{name}'s gauges are {t.gauges}, recomputed {verdict.gauges}"
                tally.count(holds, t.session, t.j, t.k, text)
                agreed += name == "plant" and expected != NO_SYMBOL
    tally.note = f"{agreed} keys agreed"


def coin(e: Evidence, tally: Tally) -> None:
    """Equation (22): the key is b_r."""
    if not need(tally, plant_trace=e.plant):
        return
    assert e.plant is not None
    left = 0
    for t in e.plant.transitions:
        if t.symbol == NO_SYMBOL:
            continue
        coin = t.coin if t.coin is not None else NO_SYMBOL
        gauge = t.gauges[coin] if 0 <= coin < len(t.gauges) else 0.0
        outside = gauge > 1 + EDGE and may_leave(e)
        left += outside and t.symbol != coin
        text = f"agreed on {t.symbol}, the plant's coin was {coin}"
        tally.count(t.symbol == coin or outside, t.session, t.j, t.k, text)
    if left:
        tally.note = f"{left} unlike the coin, each with a disturbance outside D_c"


def _automaton(e: Evidence, sessions: dict[str, list[Counted]], tally: Tally) -> None:
    for session, ts in sessions.items():
        p = 0
        for t, _, (agreed, pad), s in walk(e, ts):
            role, recovered = "test", NO_SYMBOL
            if pad != NO_SYMBOL:
                role, recovered = "message", decrypt(t.cipher, pad, e.rules.size)
                p += 1
            expected = (role, pad, recovered, p, s, agreed)
            got = (t.role, t.key, t.message_symbol, t.p, t.s, t.symbol)
            text = f"(role, key, m, p, s, symbol) is {got}, the scheme says {expected}"
            if not tally.count(got == expected, session, t.j, t.k, text):
                p = t.p
    tally.note = f"sessions: {len(sessions)}"


def sender(e: Evidence, tally: Tally) -> None:
    """The scheme over the controller's trace."""
    if need(tally, controller_trace=e.controller):
        assert e.controller is not None
        _automaton(e, e.controller.sessions, tally)


def receiver(e: Evidence, tally: Tally) -> None:
    """The scheme over the plant's trace."""
    if need(tally, plant_trace=e.plant):
        assert e.plant is not None
        _automaton(e, e.plant.sessions, tally)


_SHARED: Final = tuple(f.name for f in fields(Counted) if f.name not in ("coin", "u"))


def in_step(e: Evidence, tally: Tally) -> None:
    """Both traces agree; the controller's may lack the last transition."""
    if not need(tally, plant_trace=e.plant, controller_trace=e.controller):
        return
    assert e.plant is not None
    assert e.controller is not None
    ahead = 0
    for session, theirs in e.controller.sessions.items():
        if session not in e.plant.sessions:
            tally.fail(session, 0, theirs[0].k, "the plant's trace does not have this session")
    for session, ours in e.plant.sessions.items():
        theirs = e.controller.sessions.get(session, [])
        for a, b in zip(ours, theirs, strict=False):
            unlike = [name for name in _SHARED if getattr(a, name) != getattr(b, name)]
            text = ""
            if unlike:
                mine, other = getattr(a, unlike[0]), getattr(b, unlike[0])
                text = f"{', '.join(unlike)}: the plant has {mine}, the controller {other}"
            tally.count(not unlike, session, a.j, a.k, text)
        lead = len(ours) - len(theirs)
        ahead += lead == 1
        if lead not in (0, 1):
            t = ours[min(len(theirs), len(ours) - 1)]
            text = f"the plant counted {len(ours)}, the controller {len(theirs)}, of which at most "
            tally.fail(session, t.j, t.k, text + "one may be under way")
    tally.note = f"{ahead} not yet counted by the controller"
