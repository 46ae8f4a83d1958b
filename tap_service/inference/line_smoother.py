"""Trajectories of a planar plant with one input, where every offer puts its state on a line.

A missed x(k+1) is drawn where its offer places it: on the line of each piece of the law that may
have been active, within the support of the disturbance about each prediction. The weight of such a
draw is the length of that piece of line over the slope, so that it is exact for an even
disturbance; where the law would have offered something else it is nil. Afterwards trajectories are
drawn backwards (Godsill, Doucet and West 2004), so that what came later counts too. Noise moves the
lines, and makes a state that was heard one more weight.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from protocol.arrays import Array, Indices
from tap_service.capture.transcript import Transition
from tap_service.inference.fitted_shape import Shape
from tap_service.inference.law import PlanarLaw
from tap_service.inference.verdicts import InferredStep

PARTICLES: Final = 640
"""Particles kept from step to step."""

DRAWS: Final = 2
"""Draws for each particle kept, of which those that contradict the law are dropped."""

SAMPLES: Final = 640
"""Trajectories drawn."""

FIRST: Final = 24_000
"""Draws of a state of which nothing is known."""

ANYWHERE: Final = 12.0
"""Where such a state is looked for, in half-widths of D_e."""

EXACT: Final = 1e-5
"""Up to which an answer that was heard exactly is the law's, over the spread of the answers."""

TRIES: Final = 48
"""Particles drawn for each trajectory backwards before all are looked at."""

ROOM: Final = 1e-6
"""Over the support: rounding."""

LOST: Final = -30.0
"""Log evidence of a step that nothing explains, and the least that one step counts."""

HOLDS: Final = 0.5
"""Share of the particles that must lie where the law's facets leave an input, or an offer that was
missed is anything."""

Cloud = tuple[Array, Array]
"""Particles, shape (N, 2), and their weights, which sum to one."""


class LineSmoother:
    """Trajectories by exact proposals.

    Parameters
    ----------
    A, B : array
        Her model.
    shape : Shape
    law : PlanarLaw
    support : array, shape (rows,)
        Of the disturbance: ``shape.rows @ d`` is at most this.
    noise : float
        Standard deviation of what she reads.
    spread : float
        Standard deviation of the answers.
    """

    def __init__(
        self,
        A: Array,
        B: Array,
        shape: Shape,
        law: PlanarLaw,
        support: Array,
        noise: float,
        spread: float,
        particles: int = PARTICLES,
    ) -> None:
        self._A, self._b, self._shape, self._law = A, B[:, 0], shape, law
        self._rows = shape.rows / support[:, None]  # the gauge of the disturbance's own support
        self._noise = noise
        self._exact = max(EXACT * max(spread, 1e-6), law.doubt)
        self._count = particles
        self._equal = np.full(particles, 1 / particles)
        self._rng = np.random.default_rng(0)
        edge = [self._reach(a) for a in (np.eye(2)[0], -np.eye(2)[0], np.eye(2)[1], -np.eye(2)[1])]
        self._box = np.array([[-edge[1], -edge[3]], [edge[0], edge[2]]])

    def _reach(self, direction: Array) -> float:
        """Largest extent of the support in a direction."""
        from scipy.optimize import linprog

        found = linprog(-direction, self._rows, np.ones(len(self._rows)), bounds=(None, None))
        assert found.fun is not None  # the support is bounded
        return -float(found.fun)

    # --- one step ---------------------------------------------------------------------------------

    def _inputs(self, x: Array, t: Transition) -> Array:
        """What was offered in states ``x``, shape (N, M): as heard, or by the law."""
        if t.candidates is not None and not self._noise:
            return np.tile(np.array(t.candidates)[:, 0], (len(x), 1))
        return self._law.offers(x)

    def _predictions(self, x: Array, t: Transition) -> Array:
        """Predictions of every particle under every candidate, shape (N, M, 2)."""
        u = self._inputs(x, t)
        return (x @ self._A.T)[:, None] + u[:, :, None] * self._b

    def _picked(self, weights: Array, count: int) -> Indices:
        """Places drawn by weights, one from each of as many equal shares.

        A draw of its own for each share: candidates come in turns, and one for all would keep time.
        """
        share = weights.cumsum()
        at = (np.arange(count) + self._rng.random(count)) * (share[-1] / count)
        found: Indices = np.minimum(np.searchsorted(share, at), len(weights) - 1)
        return found

    def _even(self, count: int) -> Array:
        """Disturbances drawn evenly over the support."""
        out = np.empty((0, 2))
        while len(out) < count:
            d = self._rng.uniform(self._box[0], self._box[1], (2 * count, 2))
            out = np.vstack([out, d[(d @ self._rows.T).max(axis=1) <= 1.0]])
        return out[:count]

    def _onward(self, cloud: Cloud, before: Transition, t: Transition) -> tuple[Cloud, float]:
        """The cloud one step on, and the log evidence of what was heard there."""
        x, w = cloud
        state = None if t.x is None else np.array(t.x)
        if state is not None and not self._noise:
            return (state[None], np.ones(1)), 0.0
        predictions = self._predictions(x, before)
        size = predictions.shape[1]
        C, v = predictions.reshape(-1, 2), np.repeat(w / size, size)
        if t.candidates is not None:
            found = self._on_lines(C, v, self._law.solved(np.array(t.candidates)), state)
            if found is not None:
                return found
        count = self._count * (DRAWS if state is None else 8)
        if state is not None:  # those that it may have come from first
            sigma = self._noise + np.ptp(self._box, axis=0) / np.sqrt(12)
            near = np.exp(-0.5 * (((state - C) / sigma) ** 2).sum(axis=1)) + 1e-12
            picked = self._picked(v * near, count)
            weights = 1 / near[picked]
        else:
            picked = self._picked(v, count)
            weights = np.ones(count)
        drawn = C[picked] + self._even(count)
        weights = weights * self._seen(drawn, state)
        lost = 0.0 if t.candidates is None else LOST
        total = weights.sum()
        if not total > 0:
            return (drawn, np.full(count, 1 / count)), LOST
        return self._thinned(drawn, weights), lost + float(np.log(total / count))

    def _seen(self, x: Array, state: Array | None) -> Array:
        """Likelihood of a state that was heard with noise."""
        if state is None:
            return np.ones(len(x))
        z = (x - state) / self._noise
        found: Array = np.exp(-0.5 * (z * z).sum(axis=1)) / (2 * np.pi * self._noise**2)
        return found

    def _thinned(self, x: Array, w: Array) -> Cloud:
        if len(x) > self._count:
            used = np.flatnonzero(w)
            if len(used) > self._count:
                picked = self._picked(w, self._count)
                return x[picked], np.full(self._count, 1 / self._count)
            x, w = x[used], w[used]
        return x, w / w.sum()

    def _on_lines(
        self, C: Array, v: Array, answers: Array, state: Array | None
    ) -> tuple[Cloud, float] | None:
        """States that are offered ``answers``, about predictions ``C`` of weights ``v``."""
        if not self._noise:
            points = self._points(answers)
            placed = None if points is None else self._at_points(C, v, points)
            if placed is not None:
                return placed
        program = int(np.abs(self._law.free).sum(axis=1).argmax())
        lines = self._law.lines(program)
        noise = self._noise
        read = np.full(len(C), answers[program])
        if noise:
            read = read + noise * self._rng.standard_normal(len(C))
        slopes = lines[:, :2]
        off = read[:, None] - lines[:, 2] - C @ slopes.T
        reach = np.maximum(
            np.abs(slopes) @ np.abs(self._box).max(axis=0), 1e-12
        )  # of the box about the support
        r, p = np.nonzero(np.abs(off) <= reach)
        if not len(r):
            return None
        s, norm = slopes[p], (slopes[p] ** 2).sum(axis=1)
        base = s.T * (off[r, p] / norm)
        along = np.stack([-s[:, 1], s[:, 0]]) / np.sqrt(norm)
        a, b = self._rows @ along, 1.0 - self._rows @ base  # a row of the support each
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = b / a
        most = np.where(a > 1e-12, ratio, np.inf).min(axis=0)
        least = np.where(a < -1e-12, ratio, -np.inf).max(axis=0)
        length = np.where((np.abs(a) <= 1e-12) & (b < 0), -np.inf, 0.0).min(axis=0)
        length = np.maximum(most - least + length, 0.0)
        weights = v[r] * length / np.sqrt(norm)
        total = weights.sum()
        if not total > 0:
            return None
        count = self._count * (DRAWS if state is None else 4)
        picked = self._picked(weights, count)
        part = self._rng.random(count)
        t = least[picked] + part * (most - least)[picked]
        x = C[r[picked]] + (base[:, picked] + t * along[:, picked]).T
        found = self._law.answers(x)
        ok = np.abs(found[:, program] - read[r[picked]]) <= self._exact
        w = ok * self._seen(x, state)
        for q in range(self._law.programs):
            if q == program:
                continue
            off_q = found[:, q] - answers[q]
            if noise:
                w = w * np.exp(-0.5 * (off_q / noise) ** 2)
            else:
                w = w * (np.abs(off_q) <= self._exact)
        if not w.sum() > 0:
            return None
        return self._thinned(x, w), float(np.log(total) + np.log(w.sum()) - np.log(count))

    def _points(self, answers: Array) -> Array | None:
        """States in which two programs answered so, where their answers make two lines."""
        free = np.abs(self._law.free).sum(axis=1) > 0
        first = int(np.abs(self._law.free).sum(axis=1).argmax())
        second = [
            q
            for q in range(len(answers))
            if abs(answers[q] - answers[first]) > self._exact
            and (free[q] or abs(answers[q]) > self._exact)
        ]
        if not second:
            return None
        P, Q = self._law.lines(first), self._law.lines(second[0])
        Q = Q[np.abs(Q[:, :2]).sum(axis=1) > 0]
        p, q = (i.ravel() for i in np.meshgrid(range(len(P)), range(len(Q)), indexing="ij"))
        M = np.stack([P[p, :2], Q[q, :2]], axis=1)
        y = np.stack([answers[first] - P[p, 2], answers[second[0]] - Q[q, 2]], axis=1)
        det = np.linalg.det(M)
        good = np.abs(det) > 1e-9
        x = np.linalg.solve(M[good], y[good][:, :, None])[:, :, 0]
        ok = np.abs(self._law.answers(x) - answers).max(axis=1) <= self._exact
        return x[ok] if ok.any() else None

    def _at_points(self, C: Array, v: Array, points: Array) -> tuple[Cloud, float] | None:
        d = points[:, None] - C
        inside = (d @ self._rows.T).max(axis=2) <= 1 + ROOM
        w = inside @ v
        if not w.sum() > 0:
            return None
        return (points, w / w.sum()), float(np.log(w.sum()))

    def _begin(self, t: Transition) -> Cloud:
        """The cloud of a state of which nothing came before."""
        if t.x is not None:
            state = np.array(t.x)
            if not self._noise:
                return state[None], np.ones(1)
            x = state + self._noise * self._rng.standard_normal((self._count, 2))
            return x, np.full(self._count, 1 / self._count)
        edge = ANYWHERE / np.abs(self._shape.rows).max(axis=0)
        x = self._rng.uniform(-edge, edge, (FIRST, 2))
        if t.candidates is None:
            return x[: 4 * self._count], np.full(4 * self._count, 1 / (4 * self._count))
        answers = self._law.solved(np.array(t.candidates))
        program = int(np.abs(self._law.free).sum(axis=1).argmax())
        lines = self._law.lines(program)
        line = lines[self._rng.integers(len(lines), size=FIRST)]
        norm = (line[:, :2] ** 2).sum(axis=1)
        gap = answers[program] - line[:, 2] - (x * line[:, :2]).sum(axis=1)
        x = x + line[:, :2] * (gap / norm)[:, None]
        off = np.abs(self._law.answers(x) - answers).max(axis=1)
        ok = off <= max(self._exact, 3 * self._noise)
        x = x[ok][: 8 * self._count] if ok.any() else x[: 8 * self._count]
        return x, np.full(len(x), 1 / len(x))

    # --- forwards and backwards -------------------------------------------------------------------

    def evidence(self, transitions: Sequence[Transition]) -> float:
        """Log evidence of a run of steps."""
        return self._forward(transitions)[1]

    def _forward(self, transitions: Sequence[Transition]) -> tuple[list[Cloud], float]:
        cloud, evidence = self._begin(transitions[0]), 0.0
        clouds = [cloud]
        self._doubt: set[int] = set()
        for i, (before, t) in enumerate(pairwise(transitions)):
            cloud, gain = self._onward(cloud, before, t)
            if gain <= LOST and t.candidates is not None:  # begin anew where its offer places it
                cloud = self._begin(t)
            clouds.append(cloud)
            evidence += max(gain, LOST)  # where the law does not hold, chance says how much less
            if gain <= LOST:
                self._doubt |= {i, i + 1}
            if before.candidates is None and not self._law.holds(clouds[i][0]).mean() > HOLDS:
                self._doubt |= {i, i - 1}
        return clouds, evidence

    def infer(self, transitions: Sequence[Transition]) -> list[InferredStep]:
        """Infer steps in a row, those at the start of a session by what was heard alone."""
        first = 0 if self._noise else self._held_from(transitions)
        by_law = self._by_law(transitions[first:])
        return self._before_the_law(transitions[: first + 1]) + by_law

    def _held_from(self, transitions: Sequence[Transition]) -> int:
        """The first step whose state was heard and is where the law's facets leave an input.

        A session may start far outside T_0, where the law aims at other sets. 0 where the steps are
        from the middle of a session, or no such state was heard.
        """
        if not transitions[0].start:
            return 0
        heard = [i for i, t in enumerate(transitions) if t.x is not None]
        held = self._law.holds(np.array([transitions[i].x for i in heard]).reshape(-1, 2))
        return next((i for i, inside in zip(heard, held, strict=True) if inside), 0)

    def _before_the_law(self, transitions: Sequence[Transition]) -> list[InferredStep]:
        """All but the last of these steps, whose state was heard; their offers say no more than
        what was offered.
        """
        clouds: list[Cloud | None] = []
        for i, t in enumerate(transitions):
            before, came_from = (transitions[i - 1], clouds[-1]) if i else (None, None)
            if t.x is not None:
                clouds.append((np.array(t.x)[None], np.ones(1)))
            elif before is not None and before.candidates is not None and came_from is not None:
                clouds.append((self._moved(came_from, before, self._count), self._equal))
            else:
                clouds.append(None)
        steps: list[InferredStep] = []
        after = None if clouds[-1] is None else clouds[-1][0]
        for t, cloud in zip(transitions[-2::-1], clouds[-2::-1], strict=True):
            gauges = earlier = None
            if cloud is not None and after is not None and t.candidates is not None:
                earlier, gauges = self._back(cloud, t, after)
            elif cloud is not None:
                earlier = cloud[0][self._picked(cloud[1], SAMPLES)]
            steps.append(InferredStep(t, gauges))
            after = cloud[0] if t.x is not None and cloud is not None else earlier
        return steps[::-1]

    def _moved(self, cloud: Cloud, t: Transition, count: int) -> Array:
        """States after a step, each candidate as likely."""
        x, w = cloud
        predictions = self._predictions(x, t)
        size = predictions.shape[1]
        picked = self._picked(np.repeat(w / size, size), count)
        return predictions.reshape(-1, 2)[picked] + self._even(count)

    def _by_law(self, transitions: Sequence[Transition]) -> list[InferredStep]:
        clouds, _ = self._forward(transitions)
        last = transitions[-1]
        steps: list[InferredStep] = []
        end = None if last.x_next is None else np.array(last.x_next)
        if end is None:
            after = self._rng.permutation(self._moved(clouds[-1], last, SAMPLES))
        elif self._noise:
            after = end + self._noise * self._rng.standard_normal((SAMPLES, 2))
        else:
            after = end[None]
        for i in range(len(transitions) - 1, -1, -1):
            before, gauges = self._back(clouds[i], transitions[i], after)
            t = transitions[i]
            kept: Array | None = gauges
            if i in self._doubt and self._noise:
                kept = self._alone(t)
            elif i in self._doubt and not t.whole:
                kept = None
            steps.append(InferredStep(t, kept))
            after = before
            if i and transitions[i].x is not None and not self._noise:
                after = clouds[i][0]
        return steps[::-1]

    def _alone(self, t: Transition) -> Array | None:
        """Gauges of a step that was heard whole through noise, by that alone, shape (S, M)."""
        if t.x is None or t.candidates is None or t.x_next is None:
            return None

        def blurred(value: Sequence[float]) -> Array:
            noise = self._rng.standard_normal((SAMPLES, len(value)))
            return np.array(value) + self._noise * noise

        u = blurred([candidate for (candidate,) in t.candidates])
        predictions = (blurred(t.x) @ self._A.T)[:, None] + u[:, :, None] * self._b
        d = blurred(t.x_next)[:, None] - predictions
        inside = _largest(d, self._rows).min(axis=1) <= 1
        return self._shape.gauges(d[inside] if inside.any() else d)

    def _back(self, cloud: Cloud, t: Transition, after: Array) -> tuple[Array, Array]:
        """States before ``after``, shape (S, 2), and the gauges of that step, shape (S, M)."""
        x, w = cloud
        predictions = self._predictions(x, t)
        if len(x) == 1:
            gauges = self._shape.gauges(after[:, None] - predictions)
            if len(after) == 1 or t.x is None:
                return np.tile(x, (len(after), 1)), gauges
            return x, gauges
        if len(after) == 1:
            after = np.tile(after, (SAMPLES, 1))
        # drawn until one may have led there; each of those that none did against all
        size, share = predictions.shape[1], w.cumsum()
        tried = np.searchsorted(share, self._rng.random((len(after), TRIES)) * share[-1])
        tried = np.minimum(tried, len(x) - 1)
        at = predictions[tried, self._rng.integers(size, size=tried.shape)]
        fits = _largest(after[:, None] - at, self._rows) <= 1 + ROOM
        chosen = tried[np.arange(len(after)), fits.argmax(axis=1)]
        none = np.flatnonzero(~fits.any(axis=1))
        if len(none):
            chosen[none] = self._of_all(predictions, w, after[none])
        return x[chosen], self._shape.gauges(after[:, None] - predictions[chosen])

    def _of_all(self, predictions: Array, w: Array, after: Array) -> Indices:
        """Which particle led to each state, drawn from all."""
        own = _largest(after[:, None, None] - predictions, self._rows)
        weights = (w[:, None] * (own <= 1 + ROOM)).reshape(len(after), -1)
        none = ~weights.any(axis=1)
        if none.any():
            nearest = own[none].reshape(int(none.sum()), -1)
            weights[none] = np.exp(-20 * (nearest - nearest.min(axis=1, keepdims=True)))
        share = weights.cumsum(axis=1)
        at = self._rng.random((len(after), 1)) * share[:, -1:]
        chosen = (share < at).sum(axis=1) // predictions.shape[1]
        found: Indices = np.minimum(chosen, len(w) - 1)
        return found


def _largest(d: Array, rows: Array) -> Array:
    """Gauges of ``d``, shape (..., 2): the largest of the products with ``rows``."""
    turned = len(rows) % 2 == 0 and bool((rows[1::2] == -rows[::2]).all())
    x, y = np.ascontiguousarray(d[..., 0]), np.ascontiguousarray(d[..., 1])
    out = np.zeros(x.shape)
    for a, b in rows[::2] if turned else rows:
        product = x * a if b == 0 else (y * b if a == 0 else x * a + y * b)
        np.maximum(out, np.abs(product) if turned else product, out=out)
    return out
