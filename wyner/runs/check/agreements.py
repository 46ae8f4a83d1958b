"""Agreements: what two records of one thing must have alike, joined by session and number."""

from typing import Final

import numpy as np

from protocol.agreement import NO_SYMBOL
from wyner.runs.blocks import Blocks, ended
from wyner.runs.check.evidence import Evidence, Finding, Findings, columns
from wyner.runs.lines import LARGEST, TRANSITION
from wyner.runs.trace import Places, Rows, Trace

OWN: Final = ("session", "coin", "u", "expected", "true_x", "true_u")
"""What one end alone knows, or numbers by itself."""

WRITTEN: Final = ("x", "candidates", "x_next", "gauges", "predictions")
"""What an attack on the bus has a say in."""

DIGITS_OF_A_KEY: Final = 8 * 32
"""At most: a key is 256 bits."""


def in_step(e: Evidence, plant: Trace, controller: Trace) -> Findings:
    """Both ends agree on every transition; the controller's may lack the last of a session."""
    rows = plant.rows
    places = Places(plant, rows, by="j")
    known = np.array([places.session(name) for name in controller.sessions], np.int64)
    met = np.zeros(len(rows), bool)
    begun = not (plant.gone or controller.gone)  # else they are compared from where they meet
    for theirs in controller.chunks(TRANSITION):
        at = places.all_of(known[theirs["session"]], theirs["j"])
        there = at >= 0
        for row in theirs[~there] if begun else ():
            if not plant.may_lack(*controller.where(row)):
                text = "the plant's trace does not have this transition"
                yield Finding("in-step", *controller.where(row), text)
        if there.any():
            met[: 0 if begun else at[there][0]] = begun = True
            met[at[there]] = True
            yield from _compared(e, plant, rows[at[there]], theirs[there])
    made = np.flatnonzero(rows["kind"] == TRANSITION)
    last = np.diff(rows["session"][made], append=-1) != 0
    for row in rows[made[~met[made] & ~last]] if begun else ():
        if not controller.may_lack(*plant.where(row)):
            text = "the controller has not counted this one, but the plant goes on"
            yield Finding("in-step", *plant.where(row), text)


def _compared(e: Evidence, plant: Trace, p: Rows, c: Rows) -> Findings:
    written = ~np.asarray(e.rewrites(p["k"]))
    for name in p.dtype.names or ():
        if name in OWN:
            continue
        unlike = (p[name] != c[name]).reshape(len(p), -1).any(axis=1)
        if name in WRITTEN:
            unlike &= written
        for i in np.flatnonzero(unlike):
            text = f"{name}: the plant has {p[name][i].tolist()}, "
            text += f"the controller {c[name][i].tolist()}"
            yield Finding("in-step", *plant.where(p[i]), text)
    keyed = e.rules.keyed and p["keyed"] & (c["expected"] != NO_SYMBOL)
    for i in np.flatnonzero(keyed & (c["expected"] != p["coin"])):
        text = f"the plant's coin was {p['coin'][i]}, the controller expected {c['expected'][i]}"
        yield Finding("same-keys", *plant.where(p[i]), text)


def once(e: Evidence) -> Findings:
    """Digits of confirmed blocks serve in order, and none twice."""
    trace, digits = e.plant, e.rules.digits
    if trace is None or not digits:
        return
    known = not trace.gone and not trace.behind
    made = {(b.session, b.number): b.keys for b in ended(trace) if b.what == "confirmed"}
    after, session = (-1, 0), -1
    for rows in trace.chunks(TRANSITION):
        fields = columns(rows, "session", "k", "message", "keyed", "block", "at")
        for number, k, message, keyed, block, at in zip(*fields, strict=True):
            if number != session:
                session, after = number, (-1, 0)
            name, text = trace.sessions[number], ""
            keys = made.get((name, block), 0 if known else LARGEST)
            if e.rules.scheme.from_stream and message != keyed:
                text = "a message symbol without digits, or digits without one"
            elif block < 0:
                text = "keyed, and the offer named no digits" if keyed else ""
            elif (block, at) < after:
                text = f"position {(block, at)} is not beyond {after}"
            elif at + digits > keys * DIGITS_OF_A_KEY:
                text = f"position {(block, at)}: its block is not confirmed, or has no such digit"
            if block >= 0:
                after = max(after, (block, at + digits))
            if text:
                yield Finding("once", name, k, text)


def blocks(e: Evidence) -> Findings:
    """A block makes as many keys as its transitions allow, at both ends; without a claim, none."""
    schedule = e.rules.schedule
    for trace in e.ends():
        if schedule is None:
            for i in np.flatnonzero(trace.rows["counts"]):
                text = f"the {trace.side} counts copies, and no key is claimed"
                yield Finding("blocks", *trace.where(trace.rows[i]), text)
            continue
        whole, cut = Blocks(schedule, trace), trace.cut
        for line in ended(trace):
            session, number, keys = line.session, line.number, line.keys
            if cut and session == cut.session and number <= schedule.block_of(cut.j + 1):
                continue  # it began before what is left
            block = whole.of(session, number)
            expected = None if block is None else max(0, block.secret_rows(schedule) - 1)
            if keys != expected:
                text = f"the {trace.side} made {keys} keys of block {number}, expected {expected}"
                yield Finding("blocks", session, -1, text)
