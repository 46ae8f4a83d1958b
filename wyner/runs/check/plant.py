"""The plant's steps: where each begins, what was applied, where it led, what was offered."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from protocol.arrays import Array
from protocol.box_observer import Box
from protocol.convex import Polytope
from wyner.runs.check.evidence import EDGE, Evidence, Finding, Findings
from wyner.runs.check.paper import f_c, scale
from wyner.runs.lines import INTERRUPTED, TRANSITION, AttackLine, Break
from wyner.runs.trace import AT_ONCE, Rows, Trace

if TYPE_CHECKING:
    from controller_service.laws.base import CandidateLaw
    from controller_service.sets.design import Design

Flags = np.ndarray[Any, np.dtype[np.bool_]]

FOLLOWS: Final = 1e-12
"""x(k+1) is written as it was computed, so the next step must begin at the same number."""


def plant(e: Evidence) -> Findings:
    """Each step begins where the last ended, applies candidate b_r, and leads into Reach^c."""
    trace = e.plant
    if trace is None:
        return
    breaks = [note.at for note in trace.notes if isinstance(note.item, Break)]
    for first in range(0, len(trace.rows), AT_ONCE):
        rows = trace.rows[first : first + AT_ONCE]
        at = np.arange(first, first + len(rows))
        part = Part(rows, trace.rows[:first][-1:], np.isin(at, breaks), np.isin(at, [*trace.gaps]))
        for i, text in (
            *_begins(e, trace, part),
            *_applied(rows),
            *_unlabelled(e, trace, part),
            *_leads(e, part),
        ):
            yield Finding("plant", *trace.where(rows[i]), text)
    said = (e.run.manifest or {}).get("attack")
    if text := unlike_manifest(trace.attack, said):
        yield Finding("plant", "", -1, text)


class Part(NamedTuple):
    """Some rows of the plant's trace, and the one before them, if any.

    Before ``new`` rows another process began to write; before ``lost`` rows lines may be lost.
    """

    rows: Rows
    before: Rows
    new: Flags
    lost: Flags


Wrong = Iterator[tuple[int, str]]
"""Numbers of rows in a part, and what is wrong with them."""


def _begins(e: Evidence, trace: Trace, part: Part) -> Wrong:
    """Steps that do not begin where the last ended."""
    rows, initial = part.rows, _initial(e)
    if len(part.before):
        ((session, place, x),) = part.before[["session", "k", "x_next"]].tolist()
        place += 1
    elif trace.cut is not None:
        session, place, x = -1, trace.cut.k + 1, trace.cut.x_next
    else:
        session, place, x = -1, 0, rows["x"][0] if initial is None else initial
    begun = rows["session"] != np.append(session, rows["session"][:-1])
    k, places = rows["k"], np.append(place, rows["k"][:-1] + 1)
    ends = np.vstack([x, rows["x_next"][:-1]])
    again = begun & (k == 0) & (places > 0)  # without a journal
    # lines were lost with the power, or its journal was an older copy
    free = begun & ~again & (part.lost | (k < places) & part.new)
    places = np.where(again, 0, np.where(free, k, places))
    ends = np.where((again | free)[:, None], rows["x"], ends)
    if initial is not None:
        ends[again] = initial
    away = ~(np.abs(rows["x"] - ends).max(axis=1) <= FOLLOWS)
    for i in np.flatnonzero((k != places) | away).tolist():
        if k[i] != places[i]:
            yield i, f"expected step k = {places[i]}"
        else:
            yield i, f"begins at x = {rows['x'][i].tolist()}, the last ended at {ends[i].tolist()}"


def _initial(e: Evidence) -> Any:
    """x(0); None where no scenario states it, and where a noisy sensor reads something else."""
    plant = e.scenario.plant
    return plant.initial_state if plant.noise is None and plant.initial_state else None


def _applied(rows: Rows) -> Wrong:
    """Transitions in which another candidate was applied than the coin's."""
    chosen = rows["candidates"][np.arange(len(rows)), np.maximum(rows["coin"], 0)]
    other = (rows["kind"] == TRANSITION) & (chosen != rows["u"]).any(axis=1)
    for i in np.flatnonzero(other).tolist():
        row = rows[i]
        yield i, f"applied {row['u'].tolist()}, which is not candidate b_r = {row['coin']}"


def _leads(e: Evidence, part: Part) -> Wrong:
    """Steps whose end the input in force does not explain."""
    if e.may_leave:
        return
    rows = part.rows
    known = told = np.zeros(len(rows), bool)
    x, u, after = rows["x"], rows["u"], rows["x_next"]
    if "true_x" in (rows.dtype.names or ()):
        told = ~np.isnan(rows["true_x"][:, 0])
        truth = np.vstack([part.before["true_x"], rows["true_x"]])[: len(rows)]
        if not len(part.before):
            truth = np.vstack([truth[:1] * np.nan, truth[:-1]])
        truth[part.lost] = np.nan
        known = ~np.isnan(truth[:, 0])
        u = np.where(told[:, None], rows["true_u"], u)
        if e.rules.outputs is None:
            x = np.where((known & told)[:, None], truth, x)
            after = np.where(told[:, None], rows["true_x"], after)
        else:
            x, after = truth, rows["true_x"]
            yield from _unheld(rows, truth, known)
    gauges = _gauges(e, rows, x, u, after, told, known)
    for i in np.flatnonzero(gauges > 1 + EDGE).tolist():
        yield i, f"x(k+1) is outside Reach^c of the applied input: gauge {gauges[i]:.6g}"


def _gauges(
    e: Evidence, rows: Rows, x: Array, u: Array, after: Array, told: Any, known: Any
) -> Array:
    """How far each step's end is from where its input led; no number where nobody knows."""
    at = np.arange(len(rows))
    counted = rows["kind"] == TRANSITION
    chosen = (rows["candidates"][at, np.maximum(rows["coin"], 0)] == rows["u"]).all(axis=1)
    traced = np.where(counted & chosen, rows["gauges"][at, np.maximum(rows["coin"], 0)], np.nan)
    if e.rules.predicted:
        return np.where(told | e.lies(rows["k"]), np.nan, traced)
    noisy = e.scenario.plant.noise is not None
    test = [np.array(v) for v in e.scenario.test_set.rows()]
    alone = [np.array(v) for v in e.scenario.defender.disturbance.rows()]
    A, B = np.array(e.scenario.A), np.array(e.scenario.B)
    ends = f_c(A, B, x, u[:, None])
    read = scale(test[0], test[1], after, ends)[:, 0] if e.rules.outputs is None else traced
    state = scale(alone[0], alone[1], after, ends)[:, 0]
    computed = np.where(noisy & known & told, state, read)
    silent = np.where(e.lies(rows["k"]), np.nan, np.where(np.isnan(traced), read, traced))
    found: Array = np.where(told, computed, silent)
    found[rows["kind"] == INTERRUPTED] = np.nan
    return found


def _unheld(rows: Rows, truth: Array, known: Flags) -> Wrong:
    """Transitions whose state was not in the box that both ends had."""
    low, high = rows["box"][:, 0], rows["box"][:, 1]
    outside = ((truth < low) | (truth > high)).any(axis=1) & known & (rows["kind"] == TRANSITION)
    for i in np.flatnonzero(outside).tolist():
        yield i, f"x(k) = {truth[i].tolist()} is not in the box that both ends have"


def _unlabelled(e: Evidence, trace: Trace, part: Part) -> Wrong:
    """Steps of an attacked plant whose labels cannot be."""
    rows, attack = part.rows, trace.attack
    if attack is None or attack.at == "bus" or "true_x" not in (rows.dtype.names or ()):
        return
    silent = np.isnan(rows["true_x"][:, 0])  # with a process died what was the truth before it
    lied = (rows["true_x"] != rows["x_next"]).any(axis=1) & (e.scenario.plant.noise is None)
    turned = (rows["true_u"] != rows["u"]).any(axis=1)
    if attack.at == "sensor":
        lied &= rows["k"] + 1 < attack.onset
    if attack.at == "actuator":
        turned &= rows["k"] < attack.onset
    first = np.arange(len(rows)) == (0 if len(part.before) == 0 else -1)
    lacking = silent & (rows["kind"] != INTERRUPTED) & ~part.new & ~first
    for i in np.flatnonzero(lacking).tolist():
        yield i, "no truth, of an attacked plant"
    for i in np.flatnonzero(~silent & (lied | turned)).tolist():
        said, true = ("reported x(k+1)", "x") if lied[i] else ("chose u", "u")
        shown = rows["x_next" if lied[i] else "u"][i].tolist()
        yield i, f"{said} = {shown}, the truth is {rows[f'true_{true}'][i].tolist()}"


def unlike_manifest(attack: AttackLine | None, said: object) -> str:
    """How what the trace names differs from the manifest; empty where it does not."""
    if said is None or attack is None:
        return ""
    told = {name: getattr(attack, name) for name in ("kind", "at", "onset", "options")}
    told["knows"] = list(attack.knows)
    return "" if told == said else f"the trace names {told}, the manifest {said}"


def admissible(e: Evidence) -> Findings:
    """(27): every candidate is in U, and leads into T_(i-1) ~ D_c."""
    from controller_service.laws.registry import cached_design, make_law
    from controller_service.sets.design import SynthesisError

    trace = e.controller or e.plant
    assert trace is not None
    try:
        design = cached_design(e.scenario)
    except SynthesisError as error:
        yield Finding("admissible", "", -1, str(error))
        return
    law = make_law(e.scenario, design)
    for offered in trace.chunks(TRANSITION):
        own = trace.side == "controller"  # what the plant was offered may be hers
        rows = offered if own else offered[~e.rewrites(offered["k"])]
        X = (
            rows["x"]
            if e.rules.outputs is None
            else np.array(
                [Box(*(tuple(edge) for edge in box)).centre for box in rows["box"].tolist()]
            )
        )
        of: dict[int, list[int]] = {}
        for i, x in enumerate(map(tuple, X.tolist())):
            try:
                of.setdefault(law.index(x), []).append(i)
            except LookupError as error:
                yield Finding("admissible", *trace.where(rows[i]), str(error))
        for index, places in of.items():
            for i, text in _of_set(e, index, X[places], rows["candidates"][places], design, law):
                yield Finding("admissible", *trace.where(rows[places[i]]), text)


def _of_set(
    e: Evidence, index: int, X: Array, U: Array, design: "Design", law: "CandidateLaw"
) -> list[tuple[int, str]]:
    """Candidates of states whose smallest set is T_i that are beyond what (27) allows."""
    from controller_service.sets.design import candidate_target

    s, K = e.scenario, law.gain(index)
    if K is not None:
        away = abs((X @ K.T)[:, None] - U).max(axis=2)
        return _beyond(away, "is {:.3g} away from K x inside T_0")
    target = Polytope(*candidate_target(design, s, max(index - 1, 0)))
    inputs = Polytope.from_rows(*s.control.inputs.rows())
    ends = f_c(np.array(s.A), np.array(s.B), X, U)
    found = _beyond(
        (ends @ target.H.T - target.h).max(axis=2),
        f"leads {{:.3g}} beyond T_{max(index - 1, 0)} ~ D_c",
    )
    return found + _beyond((U @ inputs.H.T - inputs.h).max(axis=2), "is {:.3g} beyond U")


def _beyond(excess: Array, text: str) -> list[tuple[int, str]]:
    """Candidates with an excess, shape (transitions, M), by the transition's number."""
    places = np.argwhere(~(excess <= EDGE)).tolist()
    return [(i, f"candidate {m} {text.format(excess[i, m])}") for i, m in places]
