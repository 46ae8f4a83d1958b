"""The control loop's clauses: steps, reachable sets, admissible inputs."""

from typing import Final

from protocol.agreement import NO_SYMBOL, predict
from protocol.link.fallback import Fallback
from wyner.verify.clause import EDGE, Tally, may_leave, need, sides
from wyner.verify.evidence import Counted, Evidence

FOLLOWS: Final = 1e-12
"""x(k+1) is written as it was computed, so the next step must begin at the same number."""


def traces(e: Evidence, tally: Tally) -> None:
    """Numbered without a gap, in rising steps."""
    torn = 0
    for name, side in sides(e):
        torn += side.trace.torn
        for problem in side.problems:
            tally.fail("", -1, -1, f"{name}'s trace, {problem.where}: {problem.text}")
        for session, ts in side.sessions.items():
            last_k = -1
            for place, t in enumerate(ts):
                holds = t.j == place and t.k > last_k
                tally.count(holds, session, t.j, t.k, f"{name}'s trace: expected j = {place}")
                last_k = t.k
                if not holds:
                    break
    if tally.counted == 0:
        tally.fail("", -1, -1, "no transition: nothing has happened in this run")
    overwritten = sum(len(side.overwritten) for _, side in sides(e))
    tally.note = f"{torn} torn lines, {overwritten} written again after a kill"


def switching(e: Evidence, tally: Tally) -> None:
    """Equation (15): u = candidate b_r; every step begins where the last ended."""
    if not need(tally, plant_trace=e.plant):
        return
    assert e.plant is not None
    fallback = Fallback.of(e.scenario)
    missed = 0
    for life in e.plant.lives:
        first = life[min(life)]
        x = e.scenario.plant.initial_state or first.x  # else it starts as it stands
        u = (0.0,) * e.scenario.m
        for place, k in enumerate(sorted(life)):
            step = life[k]
            j = step.j if isinstance(step, Counted) else -1
            where = (step.session, j, k)
            if not tally.count(k == place, *where, f"expected step k = {place}"):
                break
            near = all(abs(a - b) <= FOLLOWS for a, b in zip(step.x, x, strict=True))
            if not near:
                tally.fail(*where, f"begins at x = {list(step.x)}, the last ended at {list(x)}")
            if isinstance(step, Counted):
                coin = step.coin if step.coin is not None else NO_SYMBOL
                known = 0 <= coin < len(step.candidates)
                if not known or step.candidates[coin] != step.u:
                    tally.fail(*where, f"applied {step.u}, which is not candidate b_r = {coin}")
                u = step.u or u
            else:
                missed += 1
                expected = fallback.input(step.x, u)
                if step.u != expected:
                    tally.fail(*where, f"a missed step applied {step.u}, expected {expected}")
                u = step.u
            x = step.x_next
    tally.note = f"{missed} missed, {e.scenario.link.fallback} as the fallback"


def reachable(e: Evidence, tally: Tally) -> None:
    """Equations (6) and (14): the gauge of what happened is at most 1."""
    if not need(tally, plant_trace=e.plant):
        return
    assert e.plant is not None
    rule = e.rules.agreement
    if rule.alpha < 1:
        tally.fail("", -1, -1, f"alpha = {rule.alpha}: D_c is not within D_e, equation (11)")
    left, largest = 0, 0.0
    for life in e.plant.lives:
        for k, step in life.items():
            u = step.u or ()
            centre = predict(rule.A, rule.B, step.x, u)
            g = rule.gauge([a - b for a, b in zip(step.x_next, centre, strict=True)])
            largest = max(largest, g)
            inside = g <= 1 + EDGE
            left += not inside
            j = step.j if isinstance(step, Counted) else -1
            text = f"x(k+1) is outside Reach^c of the applied input: gauge {g:.6g}"
            tally.count(inside or may_leave(e), step.session, j, k, text)
    tally.note = f"largest gauge {largest:.6f}, alpha {rule.alpha:g}"
    if may_leave(e):
        tally.note += f"; the disturbance may leave D_c here, and did in {left} steps"


def admissible(e: Evidence, tally: Tally) -> None:
    """(27): u in U, and A x + B u in T_(i-1) ~ D_c."""
    side = e.controller or e.plant
    assert side is not None
    from controller_service.laws.registry import cached_design, make_law
    from controller_service.sets.design import SynthesisError
    from protocol.convex import Polytope

    try:
        design = cached_design(e.scenario)
    except SynthesisError as error:
        tally.fail("", -1, -1, str(error))
        return
    law = make_law(e.scenario, design)
    inputs = Polytope.from_rows(*e.scenario.control.inputs.rows())
    terminal = 0
    for t in side.transitions:
        where = (t.session, t.j, t.k)
        try:
            i = law.index(t.x)
        except LookupError as error:
            tally.count(False, *where, str(error))
            continue
        K = law.gain(i)
        for number, u in enumerate(t.candidates):
            if K is not None:
                terminal += 1
                away = float(abs(K @ t.x - u).max())
                text = f"candidate {number} is {away:.3g} away from K x inside T_0"
                tally.count(away <= EDGE, *where, text)
                continue
            target = Polytope(*design.targets[max(i - 1, 0)])
            beyond = target.excess(predict(e.scenario.A, e.scenario.B, t.x, u))
            text = f"candidate {number} leads {beyond:.3g} beyond T_{max(i - 1, 0)} ~ D_c"
            tally.count(beyond <= EDGE, *where, text)
            over = inputs.excess(u)
            if over > EDGE:
                tally.fail(*where, f"candidate {number} is {over:.3g} beyond U")
    if terminal:
        tally.note = f"{terminal} of them K x inside T_0"
