"""The keys' clauses: the agreement test, the automata, both ends in step."""

from dataclasses import fields
from typing import Final

from protocol.agreement import NO_SYMBOL
from protocol.schemes.switched import (
    INITIAL,
    MESSAGE,
    State,
    advance_receiver,
    advance_sender,
    decrypt,
)
from wyner.verify.clause import EDGE, Tally, may_leave, need, sides
from wyner.verify.evidence import Counted, Evidence, Side


def agreement(e: Evidence, tally: Tally) -> None:
    """Equations (20) and (21), recomputed from the raw numbers."""
    agreed = 0
    for name, side in sides(e):
        for t in side.transitions:
            verdict = e.rules.agreement.verdict(t.x, t.candidates, t.x_next)
            expected = verdict.symbol if t.role == "test" else NO_SYMBOL
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


def _automaton(side: Side, size: int, tally: Tally, *, sender: bool) -> None:
    for session, ts in side.sessions.items():
        state, p = INITIAL, 0
        for t in ts:
            role = "message" if state.s == MESSAGE else "test"
            recovered = decrypt(t.cipher, state.key, size) if role == "message" else NO_SYMBOL
            before = state
            try:
                if sender:
                    state = advance_sender(state, t.symbol, size)
                else:
                    state, recovered = advance_receiver(state, t.symbol, t.cipher, size)
            except ValueError as error:
                tally.count(False, session, t.j, t.k, str(error))
                break
            p += role == "message"
            expected = (role, before.key, recovered, p, *state)
            got = (t.role, t.key, t.message_symbol, t.p, t.s, t.symbol)
            text = f"(role, key, m, p, s, symbol) is {got}, the automaton says {expected}"
            if not tally.count(got == expected, session, t.j, t.k, text):
                state, p = State(t.s, t.symbol), t.p
    tally.note = f"sessions: {len(side.sessions)}"


def sender(e: Evidence, tally: Tally) -> None:
    """Fig. 6a over the controller's trace."""
    if need(tally, controller_trace=e.controller):
        assert e.controller is not None
        _automaton(e.controller, e.rules.size, tally, sender=True)


def receiver(e: Evidence, tally: Tally) -> None:
    """Fig. 6b over the plant's trace."""
    if need(tally, plant_trace=e.plant):
        assert e.plant is not None
        _automaton(e.plant, e.rules.size, tally, sender=False)


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
