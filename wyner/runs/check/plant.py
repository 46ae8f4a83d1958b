"""The plant's steps: where each begins, what was applied, where it led, what was offered."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from protocol.arrays import Array
from protocol.convex import Polytope
from protocol.scenario import ConvexSet
from wyner.runs.check.evidence import EDGE, Evidence, Finding, Findings
from wyner.runs.check.opinion import reached, rows_of
from wyner.runs.check.paper import f_c, scale
from wyner.runs.lines import INTERRUPTED, TRANSITION, AttackLine, Break
from wyner.runs.trace import AT_ONCE, Rows, Trace

if TYPE_CHECKING:
    from controller_service.laws.base import CandidateLaw
    from controller_service.sets.design import Design

Flags = np.ndarray[Any, np.dtype[np.bool_]]

FOLLOWS: Final = 1e-12
"""x(k+1) is written as it was computed, so the next step must begin at the same number."""


def plant(e: Evidence, trace: Trace) -> Findings:
    """Each step begins where the last ended, applies candidate b_r, and leads into Reach^c."""
    breaks = [note.at for note in trace.notes if isinstance(note.item, Break)]
    for first in range(0, len(trace.rows), AT_ONCE):
        at = np.arange(first, min(first + AT_ONCE, len(trace.rows)))
        rows, before = trace.rows[at], trace.rows[np.maximum(at - 1, 0)]
        if first == 0:
            _begin(e, trace, before[:1])
        part = StepsInTurn(rows, before, np.isin(at, breaks), np.isin(at, [*trace.gaps]))
        for i, text in (
            *_begins(e, part),
            *_applied(rows),
            *_unlabelled(e, trace, part),
            *_leads(e, part),
        ):
            yield Finding("plant", *trace.where(rows[i]), text)
    said = (e.run.manifest or {}).get("attack")
    if text := unlike_manifest(trace.attack, said):
        yield Finding("plant", "", -1, text)


class StepsInTurn(NamedTuple):
    """Some steps of the plant's trace, and the one before each.

    Before ``new`` rows another process began to write; before ``lost`` rows lines may be lost.
    """

    rows: Rows
    before: Rows
    new: Flags
    lost: Flags


Wrong = Iterator[tuple[int, str]]
"""Numbers of rows in a part, and what is wrong with them."""


def _begin(e: Evidence, trace: Trace, first: Rows) -> None:
    """Make of the first row the one before it, which is of no session."""
    x, k = _initial(e), -1
    if trace.cut is not None:
        x, k = trace.cut.x_next, trace.cut.k
    first["session"], first["k"], first["x_next"] = -1, k, first["x"] if x is None else x
    if _tells_truth(first):
        first["true_x"] = np.nan


def _initial(e: Evidence) -> Any:
    """x(0); None where no scenario states it, and where a noisy sensor reads something else."""
    plant = e.scenario.plant
    return plant.initial_state if plant.noise is None and plant.initial_state else None


def _tells_truth(rows: Rows) -> bool:
    return "true_x" in (rows.dtype.names or ())


def _begins(e: Evidence, part: StepsInTurn) -> Wrong:
    """Steps that do not begin where the last ended."""
    rows, initial, k = part.rows, _initial(e), part.rows["k"]
    places, ends = part.before["k"] + 1, part.before["x_next"]
    begun = rows["session"] != part.before["session"]
    again = begun & (k == 0) & (places > 0)  # without a journal
    # lines were lost with the power, or its journal was an older copy
    free = again | begun & (part.lost | (k < places) & part.new)
    places = np.where(free, k, places)
    ends = np.where(free[:, None], rows["x"], ends)
    if initial is not None:
        ends[again] = initial
    away = ~(np.abs(rows["x"] - ends).max(axis=1) <= FOLLOWS)
    for i in np.flatnonzero((k != places) | away).tolist():
        if k[i] != places[i]:
            yield i, f"expected step k = {places[i]}"
        else:
            yield i, f"begins at x = {rows['x'][i].tolist()}, the last ended at {ends[i].tolist()}"


def _applied(rows: Rows) -> Wrong:
    """Transitions in which another candidate was applied than the coin's."""
    chosen = rows["candidates"][np.arange(len(rows)), np.maximum(rows["coin"], 0)]
    other = (rows["kind"] == TRANSITION) & (chosen != rows["u"]).any(axis=1)
    for i in np.flatnonzero(other).tolist():
        row = rows[i]
        yield i, f"applied {row['u'].tolist()}, which is not candidate b_r = {row['coin']}"


def _leads(e: Evidence, part: StepsInTurn) -> Wrong:
    """Steps whose end the input in force does not explain, as it was read or in truth."""
    rows, rules, noisy = part.rows, e.rules, e.scenario.plant.noise is not None
    if e.may_leave:
        return
    if rules.predicted or rules.outputs is not None:
        led = reached(e, rows)[np.arange(len(rows)), np.maximum(rows["coin"], 0)]
        known = rows["kind"] == TRANSITION
    else:
        led = _led(e, e.scenario.test_set, rows["x"], rows["u"], rows["x_next"])
        known = rows["kind"] != INTERRUPTED
    gauges = np.where(known & ~e.lies(rows["k"]), led, np.nan)
    if _tells_truth(rows) and not rules.predicted:
        truth = part.before["true_x"]
        truth[part.lost | (rows["k"] != part.before["k"] + 1)] = np.nan
        if rules.outputs is not None:
            yield from _unheld(rows, truth)
        elif not noisy:
            truth = np.where(np.isnan(truth), rows["x"], truth)
        led = _led(e, e.scenario.defender.disturbance, truth, rows["true_u"], rows["true_x"])
        gauges = np.fmax(gauges, np.where(rows["kind"] != INTERRUPTED, led, np.nan))
    for i in np.flatnonzero(gauges > 1 + EDGE).tolist():
        yield i, f"x(k+1) is outside Reach^c of the applied input: gauge {gauges[i]:.6g}"


def _led(e: Evidence, allowed: ConvexSet, x: Array, u: Array, x_next: Array) -> Array:
    """How much a set of disturbances must grow for each input to lead to x(k+1)."""
    ends = f_c(np.array(e.scenario.A), np.array(e.scenario.B), x, u[:, None])
    return scale(*rows_of(allowed), x_next, ends)[:, 0]


def _unheld(rows: Rows, truth: Array) -> Wrong:
    """Transitions whose state was not in the box that both ends had."""
    outside = (truth < rows["box"][:, 0]) | (truth > rows["box"][:, 1])
    for i in np.flatnonzero(outside.any(axis=1) & (rows["kind"] == TRANSITION)).tolist():
        yield i, f"x(k) = {truth[i].tolist()} is not in the box that both ends have"


def _unlabelled(e: Evidence, trace: Trace, part: StepsInTurn) -> Wrong:
    """Steps of an attacked plant whose labels cannot be."""
    rows, attack = part.rows, trace.attack
    if attack is None or attack.at == "bus" or not _tells_truth(rows):
        return
    silent = np.isnan(rows["true_x"][:, 0])  # with a process died what was the truth before it
    lied = (rows["true_x"] != rows["x_next"]).any(axis=1) & (e.scenario.plant.noise is None)
    turned = (rows["true_u"] != rows["u"]).any(axis=1)
    if attack.at == "sensor":
        lied &= rows["k"] + 1 < attack.onset
    if attack.at == "actuator":
        turned &= rows["k"] < attack.onset
    begins = part.new | (part.before["session"] == -1)
    for i in np.flatnonzero(silent & (rows["kind"] != INTERRUPTED) & ~begins).tolist():
        yield i, "no truth, of an attacked plant"
    for name, true, wrong in (("x_next", "true_x", lied), ("u", "true_u", turned)):
        for i in np.flatnonzero(wrong & ~silent).tolist():
            yield i, f"{name} is {rows[name][i].tolist()}, the truth is {rows[true][i].tolist()}"


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
    own = trace is e.controller  # what the plant was offered may be Eve's
    try:
        design = cached_design(e.scenario)
    except SynthesisError as error:
        yield Finding("admissible", "", -1, str(error))
        return
    law = make_law(e.scenario, design)
    for offered in trace.chunks(TRANSITION):
        rows = offered if own else offered[~e.rewrites(offered["k"])]
        X = rows["x"] if e.rules.outputs is None else rows["box"].sum(axis=1) / 2
        of: dict[int, list[int]] = {}
        for i, x in enumerate(map(tuple, X.tolist())):
            try:
                of.setdefault(law.index(x), []).append(i)
            except LookupError as error:
                yield Finding("admissible", *trace.where(rows[i]), str(error))
        for index, places in of.items():
            U = rows["candidates"][places]
            for excess, text in _excesses(e, index, X[places], U, design, law):
                for i, m in np.argwhere(~(excess <= EDGE)):
                    said = f"candidate {m} {text.format(excess[i, m])}"
                    yield Finding("admissible", *trace.where(rows[places[i]]), said)


def _excesses(
    e: Evidence, index: int, X: Array, U: Array, design: "Design", law: "CandidateLaw"
) -> Iterator[tuple[Array, str]]:
    """How far candidates are beyond what (27) allows where a state's smallest set is T_i."""
    from controller_service.sets.design import candidate_target

    s, K = e.scenario, law.gain(index)
    if K is not None:
        yield abs((X @ K.T)[:, None] - U).max(axis=2), "is {:.3g} away from K x inside T_0"
        return
    lower = max(index - 1, 0)
    H, h = candidate_target(design, s, lower)
    ends = f_c(np.array(s.A), np.array(s.B), X, U)
    yield (ends @ H.T - h).max(axis=2), f"leads {{:.3g}} beyond T_{lower} ~ D_c"
    inputs = Polytope.from_rows(*s.control.inputs.rows())
    yield (U @ inputs.H.T - inputs.h).max(axis=2), "is {:.3g} beyond U"
