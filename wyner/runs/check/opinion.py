"""The second opinion: what code that shares nothing with the ends says of a trace."""

from typing import Any, Final

import numpy as np

from protocol.agreement import NO_SYMBOL
from protocol.arrays import Array
from protocol.scenario import ConvexSet
from wyner.runs.check.evidence import EDGE, Evidence, Finding, Findings
from wyner.runs.check.paper import (
    ROUNDING,
    Automata,
    Keys,
    Line,
    f_c,
    key_symbols,
    output_scale,
    scale,
)
from wyner.runs.lines import TRANSITION
from wyner.runs.trace import Rows, Trace

TINY: Final = 1e-12
"""In place of alpha - 1 where alpha is 1: no two candidates are possible for her."""

COLUMNS: Final = (
    "session", "k", "cipher", "message", "key", "message_symbol", "p", "s", "symbol",
)  # fmt: skip


def paper(e: Evidence) -> Findings:
    """Figs. 5 and 6 and their equations; at the plant (14) and (22) as well."""
    if not skipped(e):
        for trace in e.ends():
            yield from _of(e, trace)
    if e.plant is not None and not e.rules.scheme.corrects:  # a key is no coin
        yield from _coin(e, e.plant)


def skipped(e: Evidence) -> str:
    """Why the figures say nothing of a run; empty where they do."""
    scheme = e.scenario.secrecy.scheme
    own = "" if scheme in ("switched", "pipelined") else scheme
    return f"{own} is a scheme of its own, not the paper's" if own else ""


def _of(e: Evidence, trace: Trace) -> Findings:
    always, session = e.scenario.secrecy.scheme == "pipelined", -1
    automata, cut = Automata(e.rules.size), trace.cut
    for rows in trace.chunks(TRANSITION):
        reached, keys = _verdicts(e, rows)
        fields = zip(*(rows[name].tolist() for name in COLUMNS), strict=True)
        for (number, k, cipher, *told, symbol), allowed in zip(fields, keys.tolist(), strict=True):
            if number != session:
                first = cut is not None and session < 0 and trace.sessions[number] == cut.session
                p = cut.p if cut is not None and first else 0
                automata, session = Automata(e.rules.size, tests_always=always, p=p), number
            expected = automata.step(cipher, symbol if symbol in allowed else min(allowed))
            message, key, message_symbol, p, s = told
            found = Line("message" if message else "test", key, message_symbol, p, s, symbol)
            if found != expected:
                automata.s, automata.key, automata.p = s, symbol, p
                text = f"{trace.side}: (role, key, m, p, s, symbol) is {tuple(found)}"
                where = trace.sessions[number], k
                yield Finding("paper", *where, f"{text}, Fig. 5 gives {tuple(expected)}")
        if trace.side == "plant" and not e.may_leave:
            chosen = reached[np.arange(len(rows)), rows["coin"]]
            for i in np.flatnonzero((chosen > 1 + ROUNDING) & ~e.lies(rows["k"])):
                text = f"x(k+1) is not in Reach^c of candidate b_r = {rows[i]['coin']}, (14)"
                yield Finding("paper", *trace.where(rows[i]), text)


def _verdicts(e: Evidence, rows: Rows) -> tuple[Array, Keys]:
    """How much D_c must grow about each candidate's centre, and the keys that this allows."""
    s, o = e.scenario, e.scenario.observer
    H, h = _rows(s.defender.disturbance)
    room = max(s.secrecy.alpha - 1, TINY)
    if o is not None:
        A, B, C = np.array(o.A), np.array(o.B), np.array(o.C)
        D_c, N = np.array(o.disturbance), np.array(o.noise)
        reached = output_scale(A, B, C, rows["box"], rows["candidates"], D_c, N, rows["x_next"])
        centres = rows["candidates"] @ B.T
    else:
        A, B = np.array(s.A), np.array(s.B)
        linear = not e.rules.predicted
        centres = f_c(A, B, rows["x"], rows["candidates"]) if linear else rows["predictions"]
        reached = scale(*_rows(s.test_set), rows["x_next"], centres)
    if s.defender.noise is not None:  # what is possible for her is said by the offer
        hers = np.max([scale(H, room * h, c, centres) for c in centres.swapaxes(0, 1)], axis=0)
    else:
        hers = scale(*_rows(s.eavesdropper_set), rows["x_next"], centres)
    return reached, key_symbols(reached, hers)


def _rows(allowed: ConvexSet) -> tuple[Array, Array]:
    H, h = allowed.rows()
    return np.array(H), np.array(h)


def _coin(e: Evidence, trace: Trace) -> Findings:
    """(22): the key is b_r, unless the disturbance has left D_c or the reading is a lie."""
    for rows in trace.chunks(TRANSITION):
        agreed: Any = rows["symbol"] != NO_SYMBOL
        unlike = agreed & (rows["symbol"] != rows["coin"]) & ~e.lies(rows["k"])
        if e.may_leave:
            unlike &= rows["gauges"][np.arange(len(rows)), rows["coin"]] <= 1 + EDGE
        for i in np.flatnonzero(unlike):
            text = f"agreed on {rows[i]['symbol']}, the plant's coin was {rows[i]['coin']}"
            yield Finding("paper", *trace.where(rows[i]), text)
