"""The plant's steps: where each begins, what was applied, where it led, what was offered."""

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from protocol.arrays import Array
from protocol.box_observer import Box
from protocol.convex import Polytope
from wyner.runs.check.evidence import EDGE, Evidence, Finding, Findings
from wyner.runs.check.paper import f_c, scale
from wyner.runs.lines import INTERRUPTED, TRANSITION, AttackLine, Break
from wyner.runs.trace import Rows, Trace

if TYPE_CHECKING:
    from controller_service.laws.base import CandidateLaw
    from controller_service.sets.design import Design

FOLLOWS: Final = 1e-12
"""x(k+1) is written as it was computed, so the next step must begin at the same number."""


def plant(e: Evidence) -> Findings:
    """Each step begins where the last ended, applies candidate b_r, and leads into Reach^c."""
    trace = e.plant
    if trace is None:
        return
    breaks = {note.at for note in trace.notes if isinstance(note.item, Break)}
    gaps = trace.gaps
    before: Rows = trace.rows[:0]
    for rows in trace.chunks():
        for i, text in _begins(e, trace, before, rows, breaks, gaps):
            yield Finding("plant", *trace.where(rows[i]), text)
        for i, text in _leads(e, trace, before, rows, breaks, gaps):
            yield Finding("plant", *trace.where(rows[i]), text)
        before = rows[-1:]
        breaks = {at - len(rows) for at in breaks}
        gaps = {at - len(rows) for at in gaps}
    said = (e.run.manifest or {}).get("attack")
    if text := unlike_manifest(trace.attack, said):
        yield Finding("plant", "", -1, text)


def _begins(
    e: Evidence, trace: Trace, before: Rows, rows: Rows, breaks: set[int], gaps: set[int]
) -> list[tuple[int, str]]:
    """Steps that do not begin where the last ended, or in which another candidate was applied."""
    found = []
    place, x = _start(e, trace, rows)
    if len(before):
        place, x = int(before[0]["k"]) + 1, before[0]["x_next"]
    places = np.append(place, rows["k"][:-1] + 1)
    ends = np.vstack([x, rows["x_next"][:-1]])
    away = ~(np.abs(rows["x"] - ends).max(axis=1) <= FOLLOWS)
    sessions = np.append(before["session"] if len(before) else -1, rows["session"][:-1])
    at = np.arange(len(rows))
    applied = rows["candidates"][at, np.maximum(rows["coin"], 0)]
    other = (rows["kind"] == TRANSITION) & (applied != rows["u"]).any(axis=1)
    for i in np.flatnonzero((rows["k"] != places) | away | other).tolist():
        k, begun = int(rows["k"][i]), rows["session"][i] != sessions[i]
        place, x = int(places[i]), ends[i]
        if begun and k == 0 and place:  # it began again, without a journal
            place, x = 0, _initial(e)
            x = rows["x"][i] if x is None else x
        elif begun and (i in gaps or (k < place and i in breaks)):
            # lines were lost with the power, or its journal was an older copy
            place, x = k, rows["x"][i]
        if k != place:
            found.append((i, f"expected step k = {place}"))
        elif not (np.abs(rows["x"][i] - x) <= FOLLOWS).all():
            text = f"begins at x = {rows['x'][i].tolist()}, the last ended at {x.tolist()}"
            found.append((i, text))
        if other[i]:
            text = f"which is not candidate b_r = {rows['coin'][i]}"
            found.append((i, f"applied {rows['u'][i].tolist()}, {text}"))
    return found


def _start(e: Evidence, trace: Trace, rows: Rows) -> tuple[int, Any]:
    """Where the first of all steps must begin."""
    if trace.cut is not None:
        return trace.cut.k + 1, np.array(trace.cut.x_next)
    x = _initial(e)
    return 0, rows["x"][0] if x is None and len(rows) else x


def _initial(e: Evidence) -> Any:
    """x(0); None where no scenario states it, and where a noisy sensor reads something else."""
    plant = e.scenario.plant
    known = plant.noise is None and plant.initial_state
    return np.array(plant.initial_state) if known else None


def _leads(
    e: Evidence, trace: Trace, before: Rows, rows: Rows, breaks: set[int], gaps: set[int]
) -> list[tuple[int, str]]:
    """Steps whose labels cannot be, and those whose end the input in force does not explain."""
    found = _unlabelled(e, trace, rows, breaks)
    known = np.zeros(len(rows), bool)
    x, u, after = rows["x"], rows["u"], rows["x_next"]
    told = known
    if rows.dtype.names is not None and "true_x" in rows.dtype.names:
        told = ~np.isnan(rows["true_x"][:, 0])
        truth = np.vstack([before["true_x"], rows["true_x"]])
        truth = truth[:-1] if len(before) else np.vstack([truth[:1] * np.nan, truth[:-1]])
        truth[[i for i in gaps if 0 <= i < len(rows)]] = np.nan
        known = ~np.isnan(truth[:, 0])
        u = np.where(told[:, None], rows["true_u"], u)
        if e.rules.outputs is None:
            x = np.where((known & told)[:, None], truth, x)
            after = np.where(told[:, None], rows["true_x"], after)
        else:
            x, after = truth, rows["true_x"]
            found += _unheld(e, rows, truth, known)
    gauges = _gauges(e, rows, x, u, after, told, known)
    for i in np.flatnonzero(gauges > 1 + EDGE).tolist():
        if not e.may_leave:
            text = f"x(k+1) is outside Reach^c of the applied input: gauge {gauges[i]:.6g}"
            found.append((i, text))
    return found


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


def _unheld(e: Evidence, rows: Rows, truth: Array, known: Any) -> list[tuple[int, str]]:
    """Transitions whose state was not in the box that both ends had."""
    low, high = rows["box"][:, 0], rows["box"][:, 1]
    outside = ((truth < low) | (truth > high)).any(axis=1) & known & (rows["kind"] == TRANSITION)
    if e.may_leave:
        return []
    text = "is not in the box that both ends have"
    return [(i, f"x(k) = {truth[i].tolist()} {text}") for i in np.flatnonzero(outside).tolist()]


def _unlabelled(e: Evidence, trace: Trace, rows: Rows, breaks: set[int]) -> list[tuple[int, str]]:
    """Steps of an attacked plant whose labels cannot be."""
    attack, noisy = trace.attack, e.scenario.plant.noise is not None
    if attack is None or attack.at == "bus" or "true_x" not in (rows.dtype.names or ()):
        return []
    silent = np.isnan(rows["true_x"][:, 0]) & (rows["kind"] != INTERRUPTED)
    lied = (rows["true_x"] != rows["x_next"]).any(axis=1) if not noisy else np.zeros_like(silent)
    if attack.at == "sensor":
        lied &= rows["k"] + 1 < attack.onset
    turned = (rows["true_u"] != rows["u"]).any(axis=1)
    if attack.at == "actuator":
        turned &= rows["k"] < attack.onset
    found = []
    for i in np.flatnonzero(silent | lied | turned).tolist():
        if np.isnan(rows["true_x"][i, 0]):  # with a process died what was the truth before it
            if silent[i] and i not in breaks and i != 0:
                found.append((i, "no truth, of an attacked plant"))
        elif lied[i]:
            text = f"reported x(k+1) = {rows['x_next'][i].tolist()}, the truth is "
            found.append((i, f"{text}{rows['true_x'][i].tolist()}"))
        elif turned[i]:
            text = f"u = {rows['u'][i].tolist()} was chosen, the truth is "
            found.append((i, f"{text}{rows['true_u'][i].tolist()}"))
    return found


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
