"""The second opinion: what code that shares nothing with the ends says of a trace."""

from typing import Any, Final

import numpy as np

from protocol.agreement import NO_SYMBOL
from protocol.arrays import Array
from protocol.scenario import ConvexSet
from wyner.runs.check.evidence import EDGE, Evidence, Finding, Findings, before, columns
from wyner.runs.check.paper import (
    Automata,
    Entry,
    Keys,
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
    """Figs. 5 and 6 and their equations; at the plant (22) as well."""
    if not skipped(e):
        for trace in e.ends():
            yield from _figures(e, trace)
    if e.plant is not None and not e.rules.scheme.corrects:  # a key is no coin
        yield from _coin(e, e.plant)


def skipped(e: Evidence) -> str:
    """Why the figures say nothing of a run; empty where they do."""
    scheme = e.scenario.secrecy.scheme
    own = "" if scheme in ("switched", "pipelined") else scheme
    return f"{own} is a scheme of its own, not the paper's" if own else ""


def _figures(e: Evidence, trace: Trace) -> Findings:
    always, session, cut = e.scenario.secrecy.scheme == "pipelined", -1, before(trace)
    automata = Automata(e.rules.size)
    for rows in trace.chunks(TRANSITION):
        fields = zip(_keys(e, rows).tolist(), *columns(rows, *COLUMNS), strict=True)
        for allowed, number, k, cipher, *told, symbol in fields:
            if number != session:
                p = cut.p if cut is not None and session < 0 else 0
                automata, session = Automata(e.rules.size, tests_always=always, p=p), number
            expected = automata.step(cipher, symbol if symbol in allowed else min(allowed))
            message, key, message_symbol, p, s = told
            found = Entry("message" if message else "test", key, message_symbol, p, s, symbol)
            if found != expected:
                automata.s, automata.key, automata.p = s, symbol, p
                text = f"{trace.side}: (role, key, m, p, s, symbol) is {tuple(found)}"
                where = trace.sessions[number], k
                yield Finding("paper", *where, f"{text}, Fig. 5 gives {tuple(expected)}")


def reached(e: Evidence, rows: Rows) -> Array:
    """How much the test's set must grow about each candidate's centre for x(k+1) to be in it."""
    s, o = e.scenario, e.scenario.observer
    if o is None:
        return scale(*rows_of(s.test_set), rows["x_next"], _centres(e, rows))
    A, B, C, D_c, N = map(np.array, (o.A, o.B, o.C, o.disturbance, o.noise))
    return output_scale(A, B, C, rows["box"], rows["candidates"], D_c, N, rows["x_next"])


def _centres(e: Evidence, rows: Rows) -> Array:
    """Where each candidate leads without a disturbance; of outputs, from a state of zero."""
    if e.rules.predicted:
        return np.asarray(rows["predictions"])
    if e.scenario.observer is not None:
        return np.asarray(rows["candidates"] @ np.array(e.scenario.observer.B).T)
    return f_c(np.array(e.scenario.A), np.array(e.scenario.B), rows["x"], rows["candidates"])


def _keys(e: Evidence, rows: Rows) -> Keys:
    """The keys that equations (20) to (22) allow."""
    s, centres = e.scenario, _centres(e, rows)
    if s.defender.noise is None:
        hers = scale(*rows_of(s.eavesdropper_set), rows["x_next"], centres)
    else:  # what is possible for her is said by the offer
        H, h = rows_of(s.defender.disturbance)
        room = max(s.secrecy.alpha - 1, TINY) * h
        hers = np.max([scale(H, room, c, centres) for c in centres.swapaxes(0, 1)], axis=0)
    return key_symbols(reached(e, rows), hers)


def rows_of(allowed: ConvexSet) -> tuple[Array, Array]:
    """A set as (H, h)."""
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
