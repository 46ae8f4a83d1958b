"""The control loop's checks: steps, reachable sets, admissible inputs."""

from typing import TYPE_CHECKING, Final

import numpy as np

from protocol.agreement import Gauge, predict
from protocol.arrays import Array
from protocol.box_observer import Box, Estimate
from protocol.convex import Polytope
from protocol.link.fallback import Fallback
from protocol.vectors import Vector
from wyner.runs.check.attacked import lies, rewrites, unlike_manifest, wrong_labels
from wyner.runs.check.base import EDGE, Check, Counter, may_leave
from wyner.runs.check.evidence import Evidence, Part
from wyner.runs.check.records import Break, MissedLine, TracedTransition, Walked

if TYPE_CHECKING:
    from controller_service.laws.base import CandidateLaw
    from controller_service.sets.design import Design

Step = TracedTransition | MissedLine

FOLLOWS: Final = 1e-12
"""x(k+1) is written as it was computed, so the next step must begin at the same number."""


class Switching(Check):
    """Equation (15): u = candidate b_r; every step begins where the last ended."""

    name = "switching"
    source = "(15), rule 4"
    says = "every step applies candidate b_r, a missed one the fallback"
    of = "steps"
    needs = ("plant",)

    def __init__(self, evidence: Evidence, counter: Counter) -> None:
        super().__init__(evidence, counter)
        self._fallback = Fallback.of(evidence.scenario)
        # A device is told of the fallback once a step is over: the input in force stood until then.
        self._may_stand = evidence.scenario.plant.kind == "python"
        self._missed = self._interrupted = 0
        self._place, self._born_in = 0, ""
        self._first, self._session, self._restarted = True, "", False
        self._begin()

    def _begin(self) -> None:
        """The plant starts, in no session's middle; x is empty where only it knows."""
        plant = self.evidence.scenario.plant
        self._x: Vector = plant.initial_state if plant.noise is None else ()
        self._u: Vector = (0.0,) * self.evidence.rules.inputs
        self._estimate: Estimate | None = None  # of the last transition, where outputs are read
        self._applied = -1

    def feed(self, part: Part) -> None:
        for item in part.plant:
            if self._first:
                self._first = False
                self._begin_after_the_cut()
            if isinstance(item, Walked):
                self._step(item.t, item.t.j)
                self._estimate, self._applied = item.verdict.estimate, item.t.k
            elif isinstance(item, MissedLine):
                self._step(item, -1)
            elif isinstance(item, Break):
                self._restarted = True

    def _instead(self, step: MissedLine) -> Vector:
        """The fallback's input in a missed step."""
        outputs = self.evidence.rules.outputs
        if outputs is None:
            return self._fallback.input(step.x, self._u)
        return outputs.instead(self._estimate, step.k - self._applied - 1, self._u)

    def _begin_after_the_cut(self) -> None:
        assert self.evidence.plant is not None
        cut = self.evidence.plant.cut
        if cut is not None:
            self._x, self._u = cut.x_next, cut.u or self._u
            self._place, self._born_in = cut.k + 1, cut.session

    def _step(self, step: TracedTransition | MissedLine, j: int) -> None:
        assert step.u is not None
        if step.k == 0 and step.session != self._born_in:  # it began again, without a journal
            self._born_in, self._place = step.session, 0
            self._begin()
        if step.session != self._session and step.k < self._place and self._restarted:
            self._x, self._u, self._place = step.x, step.u, step.k  # its journal was an older copy
        if step.session != self._session:
            self._estimate, self._applied = None, -1
        self._session, self._restarted = step.session, False
        x = self._x or step.x
        where = (step.session, j, step.k)
        count, fail = self.counter.count, self.counter.fail
        in_place = count(step.k == self._place, *where, f"expected step k = {self._place}")
        near = all(abs(a - b) <= FOLLOWS for a, b in zip(step.x, x, strict=True))
        if in_place and not near:
            fail(*where, f"begins at x = {list(step.x)}, the last ended at {list(x)}")
        if isinstance(step, TracedTransition):
            assert step.coin is not None
            if step.candidates[step.coin] != step.u:
                fail(*where, f"applied {step.u}, which is not candidate b_r = {step.coin}")
        elif step.interrupted:
            self._interrupted += 1
            expected = step.candidates[step.coin] if step.candidates else self._u
            if step.u != expected:
                fail(*where, f"an interrupted step had {step.u}, expected {expected}")
        else:
            self._missed += 1
            expected = self._instead(step)
            if step.u != expected and not (self._may_stand and step.u == self._u):
                fail(*where, f"a missed step applied {step.u}, expected {expected}")
        self._x, self._u, self._place = step.x_next, step.u, step.k + 1

    def finish(self) -> None:
        fallback = self.evidence.scenario.link.fallback
        self.counter.note = f"{self._missed} missed, {fallback} as the fallback"
        if self._interrupted:
            self.counter.note += (
                f"; {self._interrupted} under way when the plant's process died or a session ended"
            )


class Reachable(Check):
    """Equations (6) and (14): the gauge of what happened is at most 1.

    Of an attacked plant that is its true state, which its labels name.
    """

    name = "reachable"
    source = "(6), (14)"
    says = "x(k+1) is in Reach^c of the applied input, within Reach^e"
    of = "steps"
    needs = ("plant",)

    def __init__(self, evidence: Evidence, counter: Counter) -> None:
        super().__init__(evidence, counter)
        self._left, self._largest, self._leaves = 0, 0.0, may_leave(evidence)
        self._true: Vector | None = None  # x(k), where the step before it was labelled
        self._noisy = evidence.scenario.plant.noise is not None
        self._D_c = Gauge.from_rows(*evidence.scenario.defender.disturbance.rows())
        self._restarted = True
        self._truths, self._away = 0, 0.0

    def feed(self, part: Part) -> None:
        assert self.evidence.plant is not None
        for item in part.plant:
            if isinstance(item, Break):
                self._restarted = True
            if not isinstance(item, Walked | MissedLine):
                continue
            step = item.t if isinstance(item, Walked) else item
            attack = self.evidence.plant.attack
            if text := wrong_labels(
                attack,
                step,
                restarted=self._restarted,
                noisy=self._noisy,
                states=self.evidence.scenario.n,
            ):
                self._restarted = False
                self.counter.count(False, *_place(step), text)
                continue
            self._restarted = False
            if isinstance(item, Walked) and not self._held(item.t):
                text = f"x(k) = {self._true} is not in the box that both ends have"
                self.counter.count(self._leaves, *_place(step), text)
            gauge = self._gauge_of(item, step)
            if gauge is not None:
                self._judge(step, gauge)

    def _held(self, t: TracedTransition) -> bool:
        """Whether the state before it is in its box, as far as both are known."""
        if t.box is None or self._true is None:
            return True
        low, high = t.box
        return all(a <= v <= b for a, v, b in zip(low, self._true, high, strict=True))

    def _gauge_of(self, item: Walked | MissedLine, step: Step) -> float | None:
        """How far the true state came from where the input led; None where nobody knows."""
        e, true, x = self.evidence, step.true_x_next, self._true or step.x
        known, self._true = self._true is not None, true
        if isinstance(step, MissedLine) and (step.interrupted or e.rules.predicted):
            return None  # what was applied is not known, or where it leads nobody predicted
        if true is not None and step.true_u is not None:
            self._truths += 1
            apart = [abs(a - b) for a, b in zip(self._read(true), step.x_next, strict=True)]
            self._away = max(self._away, *apart)
            if e.rules.predicted:
                return None
            if e.rules.outputs is not None and not known:
                if not isinstance(item, Walked) or item.t.coin is None:
                    return None
                return item.verdict.gauges[item.t.coin]
            if self._noisy and known:  # by itself the state is disturbed within D_c
                centre = predict(e.scenario.A, e.scenario.B, x, step.true_u)
                return self._D_c([a - b for a, b in zip(true, centre, strict=True)])
            return _gauge(e, x, step.true_u, true)
        if e.plant is not None and lies(e.plant.attack, step.k):
            return None  # the truth went with the plant's process
        if isinstance(item, Walked):
            assert item.t.coin is not None
            if item.t.candidates[item.t.coin] == item.t.u:
                return item.verdict.gauges[item.t.coin]
        if e.rules.outputs is not None:
            return None  # the state before it stood in no reading
        return _gauge(e, step.x, step.u or (), step.x_next)

    def _read(self, x: Vector) -> Vector:
        """What exact sensors would read."""
        outputs = self.evidence.rules.outputs
        return x if outputs is None else outputs.observer.read(x)

    def _judge(self, step: Step, gauge: float) -> None:
        self._largest = max(self._largest, gauge)
        inside = gauge <= 1 + EDGE
        self._left += not inside
        text = (
            "" if inside else f"x(k+1) is outside Reach^c of the applied input: gauge {gauge:.6g}"
        )
        self.counter.count(inside or self._leaves, *_place(step), text)

    def finish(self) -> None:
        e = self.evidence
        assert e.plant is not None
        if text := unlike_manifest(e.plant.attack, (e.manifest or {}).get("attack")):
            self.counter.fail("", -1, -1, text)
        alpha = e.rules.agreement.alpha
        self.counter.note = f"largest gauge {self._largest:.6f}, alpha {alpha:g}"
        if self._truths and self._noisy:
            self.counter.note += f"; readings up to {self._away:.3g} from the state itself"
        elif self._truths:
            self.counter.note += (
                f"; {self._truths} of them the true state under attack, {self._away:.3g} from "
                "what was reported at most"
            )
        if self._leaves:
            self.counter.note += (
                f"; the disturbance may leave D_c here, and did in {self._left} steps"
            )


def _place(step: Step) -> tuple[str, int, int]:
    return step.session, step.j if isinstance(step, TracedTransition) else -1, step.k


def _state(t: TracedTransition) -> Vector:
    """The state for which its candidates were found: the centre of its box, where it has one."""
    return t.x if t.box is None else Box(*t.box).centre


def _gauge(e: Evidence, x: Vector, u: Vector, x_next: Vector) -> float:
    rule = e.rules.agreement
    centre = predict(rule.A, rule.B, x, u)
    return rule.gauge([a - b for a, b in zip(x_next, centre, strict=True)])


class Admissible(Check):
    """(27): u in U, and A x + B u in T_(i-1) ~ D_c."""

    name = "admissible"
    source = "(27)"
    says = "every candidate is in U and leads into T_(i-1) ~ D_c"
    of = "candidates"

    def __init__(self, evidence: Evidence, counter: Counter) -> None:
        from controller_service.laws.registry import cached_design, make_law
        from controller_service.sets.design import SynthesisError

        super().__init__(evidence, counter)
        self._terminal = 0
        try:
            design = cached_design(evidence.scenario)
        except SynthesisError as error:
            counter.fail("", -1, -1, str(error))
            self._sets = None
        else:
            self._sets = design, make_law(evidence.scenario, design)

    def feed(self, part: Part) -> None:
        if self._sets is None:
            return
        _, law = self._sets
        of: dict[int, list[TracedTransition]] = {}
        e = self.evidence
        for plant, controller in part.pairs:
            t = (controller or plant).t  # type: ignore[union-attr]
            if controller is None and e.plant is not None and rewrites(e.plant.attack, t.k):
                continue  # what the plant was offered is hers
            try:
                of.setdefault(law.index(_state(t)), []).append(t)
            except LookupError as error:
                self.counter.count(False, t.session, t.j, t.k, str(error))
        for i, ts in of.items():
            self._of_set(i, ts, *self._sets)

    def _of_set(
        self, i: int, ts: list[TracedTransition], design: "Design", law: "CandidateLaw"
    ) -> None:
        """Judge the candidates of states whose smallest set is T_i."""
        from controller_service.sets.design import candidate_target

        s = self.evidence.scenario
        X = np.array([_state(t) for t in ts])
        U = np.array([t.candidates for t in ts])
        K = law.gain(i)
        if K is not None:
            away = abs((X @ K.T)[:, None] - U).max(axis=2)
            self._terminal += away.size
            self._judge(ts, away, "is {:.3g} away from K x inside T_0")
            return
        target = Polytope(*candidate_target(design, s, max(i - 1, 0)))
        predictions = (X @ np.array(s.A).T)[:, None] + U @ np.array(s.B).T
        beyond = (predictions @ target.H.T - target.h).max(axis=2)
        self._judge(ts, beyond, f"leads {{:.3g}} beyond T_{max(i - 1, 0)} ~ D_c")
        inputs = Polytope.from_rows(*s.control.inputs.rows())
        over = (U @ inputs.H.T - inputs.h).max(axis=2)
        for at, number in np.argwhere(~(over <= EDGE)).tolist():
            t = ts[at]
            text = f"candidate {number} is {over[at, number]:.3g} beyond U"
            self.counter.fail(t.session, t.j, t.k, text)

    def _judge(self, ts: list[TracedTransition], excess: Array, text: str) -> None:
        """Count candidates by their excess, shape (transitions, M)."""
        self.counter.counted += excess.size
        for at, number in np.argwhere(~(excess <= EDGE)).tolist():
            t = ts[at]
            where = (t.session, t.j, t.k)
            self.counter.fail(*where, f"candidate {number} {text.format(excess[at, number])}")

    def finish(self) -> None:
        if self._terminal:
            self.counter.note = f"{self._terminal} of them K x inside T_0"
