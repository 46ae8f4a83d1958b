"""The control loop's clauses: steps, reachable sets, admissible inputs."""

from typing import Final

import numpy as np

from protocol.agreement import predict
from protocol.arrays import Array
from protocol.convex import Polytope
from protocol.link.fallback import Fallback
from protocol.vectors import Vector
from wyner.runs.check.attacked import Labels, wanting
from wyner.runs.check.clause import EDGE, Judging, Tally, may_leave, need
from wyner.runs.check.evidence import Evidence
from wyner.runs.check.records import Break, MissedLine, TracedTransition, Walked

FOLLOWS: Final = 1e-12
"""x(k+1) is written as it was computed, so the next step must begin at the same number."""


def switching(e: Evidence, tally: Tally) -> Judging:
    """Equation (15): u = candidate b_r; every step begins where the last ended."""
    if not need(tally, plant_trace=e.plant):
        return
    fallback = Fallback.of(e.scenario)
    # A device is told of the fallback once a step is over: the input in force stood until then.
    may_stand = e.scenario.plant.kind == "python"
    zero = (0.0,) * e.rules.inputs
    missed, interrupted, place = 0, 0, 0
    start = e.scenario.plant.initial_state  # empty where the plant starts as it stands
    x, u = start, zero
    born_in, first = "", True
    session, restarted = "", False
    while (part := (yield)) is not None:
        for item in part.plant:
            cut = e.plant.cut if first and e.plant is not None else None
            if cut is not None:
                x, u, place, born_in = cut.x_next, cut.u or zero, cut.k + 1, cut.session
            first = False
            if isinstance(item, Walked):
                step: TracedTransition | MissedLine = item.t
            elif isinstance(item, MissedLine):
                step = item
            else:
                restarted = restarted or isinstance(item, Break)
                continue
            if step.k == 0 and step.session != born_in:  # the plant began again, without a journal
                born_in, place = step.session, 0
                x, u = start, zero
            if step.session != session and step.k < place and restarted:
                x, u, place = step.x, step.u or zero, step.k  # its journal was an older copy
            session, restarted = step.session, False
            x = x or step.x
            j = step.j if isinstance(step, TracedTransition) else -1
            where = (step.session, j, step.k)
            tally.count(step.k == place, *where, f"expected step k = {place}")
            near = all(abs(a - b) <= FOLLOWS for a, b in zip(step.x, x, strict=True))
            if not near and step.k == place:
                tally.fail(*where, f"begins at x = {list(step.x)}, the last ended at {list(x)}")
            assert step.u is not None
            if isinstance(step, TracedTransition):
                assert step.coin is not None
                if step.candidates[step.coin] != step.u:
                    text = f"applied {step.u}, which is not candidate b_r = {step.coin}"
                    tally.fail(*where, text)
            elif step.interrupted:
                interrupted += 1
                expected = step.candidates[step.coin] if step.candidates else u
                if step.u != expected:
                    tally.fail(*where, f"an interrupted step had {step.u}, expected {expected}")
            else:
                missed += 1
                expected = fallback.input(step.x, u)
                if step.u != expected and not (may_stand and step.u == u):
                    tally.fail(*where, f"a missed step applied {step.u}, expected {expected}")
            x, u, place = step.x_next, step.u, step.k + 1
    tally.note = f"{missed} missed, {e.scenario.link.fallback} as the fallback"
    if interrupted:
        tally.note += f"; {interrupted} under way when the plant's process died or a session ended"


def reachable(e: Evidence, tally: Tally) -> Judging:
    """Equations (6) and (14): the gauge of what happened is at most 1.

    Of an attacked plant that is its true state, which its labels name.
    """
    if not need(tally, plant_trace=e.plant):
        return
    rule = e.rules.agreement
    left, largest, leaves = 0, 0.0, may_leave(e)
    labels, truths, away = Labels(), 0, 0.0
    true: Vector | None = None  # x(k), where a step before it was labelled
    while (part := (yield)) is not None:
        for item in part.plant:
            step = labels.step(item)
            if step is None:
                continue
            j = step.j if isinstance(step, TracedTransition) else -1
            where = (step.session, j, step.k)
            if text := labels.wrong(step):
                tally.count(False, *where, text)
            x, true = true or step.x, step.true_x_next
            if isinstance(step, MissedLine) and step.interrupted:
                continue  # what was applied is not known
            if true is not None and step.true_u is not None and len(true) == len(step.x):
                truths += 1
                away = max(away, *(abs(a - b) for a, b in zip(true, step.x_next, strict=True)))
                if e.rules.predicted:
                    continue  # nobody predicted where the truth leads
                g = _gauge(e, x, step.true_u, true)
            elif labels.lies(step.k) or (e.rules.predicted and isinstance(step, MissedLine)):
                continue
            elif isinstance(item, Walked) and _chosen(item.t) == item.t.u:
                assert item.t.coin is not None
                g = item.verdict.gauges[item.t.coin]
            else:
                g = _gauge(e, step.x, step.u or (), step.x_next)
            largest = max(largest, g)
            inside = g <= 1 + EDGE
            left += not inside
            text = f"x(k+1) is outside Reach^c of the applied input: gauge {g:.6g}"
            tally.count(inside or leaves, *where, text)
    if text := wanting(labels.attack, (e.manifest or {}).get("attack")):
        tally.fail("", -1, -1, text)
    tally.note = f"largest gauge {largest:.6f}, alpha {rule.alpha:g}"
    if truths:
        tally.note += f"; {truths} of them the true state under attack, {away:.3g} away at most"
    if leaves:
        tally.note += f"; the disturbance may leave D_c here, and did in {left} steps"


def _chosen(t: TracedTransition) -> Vector:
    assert t.coin is not None
    return t.candidates[t.coin]


def _gauge(e: Evidence, x: Vector, u: Vector, x_next: Vector) -> float:
    rule = e.rules.agreement
    centre = predict(rule.A, rule.B, x, u)
    return rule.gauge([a - b for a, b in zip(x_next, centre, strict=True)])


def admissible(e: Evidence, tally: Tally) -> Judging:
    """(27): u in U, and A x + B u in T_(i-1) ~ D_c."""
    from controller_service.laws.registry import cached_design, make_law
    from controller_service.sets.design import SynthesisError, candidate_target

    try:
        design = cached_design(e.scenario)
    except SynthesisError as error:
        tally.fail("", -1, -1, str(error))
        return
    law = make_law(e.scenario, design)
    inputs = Polytope.from_rows(*e.scenario.control.inputs.rows())
    A, B = np.array(e.scenario.A), np.array(e.scenario.B)
    terminal = 0
    while (part := (yield)) is not None:
        of: dict[int, list[TracedTransition]] = {}
        for plant, controller in part.pairs:
            t = (controller or plant).t  # type: ignore[union-attr]
            try:
                of.setdefault(law.index(t.x), []).append(t)
            except LookupError as error:
                tally.count(False, t.session, t.j, t.k, str(error))
        for i, ts in of.items():
            X = np.array([t.x for t in ts])
            U = np.array([t.candidates for t in ts])
            K = law.gain(i)
            if K is not None:
                away = abs((X @ K.T)[:, None] - U).max(axis=2)
                terminal += away.size
                _judge(tally, ts, away, "is {:.3g} away from K x inside T_0")
                continue
            target = Polytope(*candidate_target(design, e.scenario, max(i - 1, 0)))
            centres = (X @ A.T)[:, None] + U @ B.T
            beyond = (centres @ target.H.T - target.h).max(axis=2)
            _judge(tally, ts, beyond, f"leads {{:.3g}} beyond T_{max(i - 1, 0)} ~ D_c")
            over = (U @ inputs.H.T - inputs.h).max(axis=2)
            for at, number in np.argwhere(~(over <= EDGE)).tolist():
                t = ts[at]
                text = f"candidate {number} is {over[at, number]:.3g} beyond U"
                tally.fail(t.session, t.j, t.k, text)
    if terminal:
        tally.note = f"{terminal} of them K x inside T_0"


def _judge(tally: Tally, ts: list[TracedTransition], excess: Array, text: str) -> None:
    """Count candidates by their excess, shape (transitions, M)."""
    tally.counted += excess.size
    for at, number in np.argwhere(~(excess <= EDGE)).tolist():
        t = ts[at]
        where = (t.session, t.j, t.k)
        tally.fail(*where, f"candidate {number} {text.format(excess[at, number])}")
