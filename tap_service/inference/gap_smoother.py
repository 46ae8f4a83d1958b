"""States and offers that were missed, inferred from what was heard before and after.

A lost x(k) is no erasure. It lies in A x(k-1) + B u + D for one of the candidates; the next state
follows from it; and Offer(k) is a function of it, the law, which is learned from the transcript
itself (:mod:`tap_service.inference.law_pieces`). Everything is Gaussian given the applied
candidates and the pieces of the law; these are enumerated along a stretch of lost states, the
likeliest kept, and trajectories drawn from what remains. That the disturbance is bounded prunes and
weeds.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from protocol.arrays import Array
from tap_service.capture.transcript import Transition, steps_in_a_row
from tap_service.inference.fitted_shape import Shape
from tap_service.inference.inferred import InferredStep
from tap_service.inference.law_pieces import Form, LearnedLaw, Reading, heard_exactly, learn_law

SAMPLES: Final = 32
"""Trajectories drawn for a stretch with something missed."""

PATHS: Final = 24
"""Sequences of applied candidates and pieces followed through a stretch."""

LONGEST: Final = 40
"""Lost states in a row that are bridged; a longer stretch is given up."""

ROOM: Final = 1.25
"""Over the support of the disturbance: beyond it an inferred step is taken for impossible."""

ENOUGH: Final = 12
"""Steps heard whole from which the disturbance is measured."""

TINY: Final = 1e-9


@dataclass(frozen=True, slots=True)
class Path:
    """One sequence of applied candidates and pieces, with the filtered states along it."""

    weight: float
    means: tuple[Array, ...]
    covariances: tuple[Array, ...]
    choices: tuple[int, ...]
    forms: tuple[Form, ...]


FAR: Final = 4.0
"""Standard deviations beyond which a reading of the next offer is not looked at."""


class Rivals:
    """The readings of one offer, with their rows in one block, to discard most of them at once."""

    def __init__(self, readings: Sequence[Reading]) -> None:
        self._readings = readings
        counts = [len(r.y) for r in readings]
        self._owner = np.repeat(np.arange(len(readings)), counts)
        if any(counts):
            self._C = np.concatenate([r.C for r in readings])
            self._y = np.concatenate([r.y for r in readings])
            self._R = np.concatenate([r.R.diagonal() for r in readings])

    def within(self, centre: Array, P: Array) -> list[Reading]:
        """The readings that a Gaussian about ``centre`` does not rule out."""
        if not len(self._owner):
            return list(self._readings)
        variance = ((self._C @ P) * self._C).sum(axis=1) + self._R
        far = (self._y - self._C @ centre) ** 2 > FAR**2 * variance
        out = set(self._owner[far].tolist())
        return [r for i, r in enumerate(self._readings) if i not in out]


class GapSmoother:
    """Infers the transitions of a transcript.

    Parameters
    ----------
    A, B : array
        Her model.
    shape : Shape
    noise : float
        Standard deviation of what she reads.
    samples : int
        Trajectories drawn for a stretch with something missed.
    """

    def __init__(
        self, A: Array, B: Array, shape: Shape, noise: float, samples: int = SAMPLES
    ) -> None:
        self._A, self._B, self._noise = A, B, noise
        self._bounded, self._shape = shape.bounded, shape.rows
        self._samples = samples
        self._n = len(A)
        self._unit = float(np.abs(shape.rows).max())
        self._rng = np.random.default_rng(0)
        self._law: LearnedLaw | None = None
        self._d_cov = np.eye(self._n)
        self.support = 1.0
        """Gauge of the largest disturbance seen, noise apart."""

    def infer(self, transitions: Sequence[Transition]) -> list[InferredStep]:
        """Infer every transition; the whole transcript that is kept, in one call."""
        heard = [t for t in transitions if t.x is not None and t.candidates is not None]
        if not heard:
            return [InferredStep(t, None) for t in transitions]
        x, u = np.array([t.x for t in heard]), np.array([t.candidates for t in heard])
        self._law = learn_law(x, u, self._noise)
        self._measure_disturbance([t for t in heard if t.x_next is not None])
        return [step for run in steps_in_a_row(transitions) for step in self._stretch(run)]

    def _measure_disturbance(self, whole: Sequence[Transition]) -> None:
        """Covariance and support of d, from the steps heard whole."""
        if len(whole) < ENOUGH:
            edge = 1.0 / np.abs(self._shape).max(axis=0)
            self._d_cov = np.diag((edge / 4) ** 2)
            self.support = 1.0
            return
        x = np.array([t.x for t in whole])
        u = np.array([t.candidates for t in whole])
        x_next = np.array([t.x_next for t in whole])
        residual = (x_next - x @ self._A.T)[:, None, :] - u @ self._B.T
        gauge = (residual @ self._shape.T).max(axis=2)
        nearest = residual[np.arange(len(whole)), gauge.argmin(axis=1)]
        self._d_cov = nearest.T @ nearest / len(whole) + TINY * np.eye(self._n)
        # noise blurs the edge: a high quantile stands for it
        self.support = float(np.quantile(gauge.min(axis=1), 0.995)) * 1.02

    def _stretch(self, transitions: list[Transition]) -> list[InferredStep]:
        """Steps in a row: node i is the state before step i; bridge from heard to heard."""
        count = len(transitions)
        heard: list[Array | None] = [None] * (count + 1)
        for i, t in enumerate(transitions):
            if t.x is not None:
                heard[i] = np.array(t.x)
            if t.x_next is not None and heard[i + 1] is None:
                heard[i + 1] = np.array(t.x_next)
        steps: list[InferredStep] = []
        i = 0
        while i < count:
            j = i + 1
            while j < count and heard[j] is None:
                j += 1
            first, last, part = heard[i], heard[j], transitions[i:j]
            if first is None or j - i > LONGEST:
                steps += [InferredStep(t, None) for t in part]
            elif j == i + 1 and last is not None:
                steps.append(InferredStep(part[0], self._direct(part[0], first, last)))
            elif self._law is None:
                steps += [InferredStep(t, None) for t in part]
            else:
                steps += self._bridge(self._law, part, first, last)
            i = j
        return steps

    # --- both states heard ------------------------------------------------------------------------

    def _direct(self, t: Transition, x: Array, x_next: Array) -> Array | None:
        """Sample only what noise or a lost offer leaves open."""
        if t.candidates is not None:
            form = heard_exactly(np.array(t.candidates), self._n)
            if self._noise == 0:
                return self._gauges(x[None], form.at(x[None]), x_next[None])
            forms = [form]
        elif self._law is not None:
            forms = self._law.forms(x)
        else:
            return None
        if not forms:
            return None
        weights = np.exp([f.weight for f in forms])
        parts = []
        for form, count in zip(
            forms, self._rng.multinomial(self._samples, weights / weights.sum()), strict=True
        ):
            if not count:
                continue
            xs = self._blurred(x, count)
            if t.candidates is not None:
                xs = self._fused(x, form.g, count)
            offers = form.at(xs) + self._errors(form, count, heard=t.candidates is not None)
            parts.append(self._gauges(xs, offers, self._blurred(x_next, count)))
        gauges = np.concatenate(parts)
        inside = gauges.min(axis=1) <= self.support
        return gauges[inside] if inside.any() else gauges

    def _blurred(self, x: Array, count: int) -> Array:
        blurred: Array = x + self._noise * self._rng.standard_normal((count, self._n))
        return blurred

    def _errors(self, form: Form, count: int, *, heard: bool) -> Array:
        size, m = form.g.shape
        if heard:
            noise: Array = self._noise * self._rng.standard_normal((count, size, m))
            return noise
        flat = self._sample(np.zeros((count, size * m)), form.R)
        return flat.reshape(count, size, m)

    def _fused(self, x: Array, offer: Array, count: int) -> Array:
        """A noisy state, together with what its offer says of it."""
        if self._law is None:
            return self._blurred(x, count)
        covariance = (self._noise**2 + TINY) * np.eye(self._n)
        mean = x
        readings = self._law.readings(offer)
        if len(readings) == 1:
            r = readings[0]
            mean, covariance, _ = _update(mean, covariance, r.C, r.y, r.R)
        return self._sample(np.tile(mean, (count, 1)), covariance)

    # --- over lost states -------------------------------------------------------------------------

    def _bridge(
        self, law: LearnedLaw, transitions: list[Transition], first: Array, last: Array | None
    ) -> list[InferredStep]:
        """From one heard state to the next, over the lost ones in between."""
        paths = [Path(0.0, (first,), (self._noise**2 * np.eye(self._n),), (), ())]
        for i, t in enumerate(transitions):
            at_end = i + 1 == len(transitions)
            following = None if at_end else transitions[i + 1].candidates
            rivals = None if following is None else Rivals(law.readings(np.array(following)))
            end = last if at_end else None
            grown = [g for p in paths for g in self._grow(law, p, t, rivals, end)]
            if not grown:
                return [InferredStep(t, None) for t in transitions]
            grown.sort(key=lambda p: -p.weight)
            paths = grown[:PATHS]
        weights = np.exp([p.weight - paths[0].weight for p in paths])
        counts = self._rng.multinomial(4 * self._samples, weights / weights.sum())
        parts = [
            self._trajectories(path, int(count), first, last)
            for path, count in zip(paths, counts, strict=True)
            if count
        ]
        gauges = np.concatenate(parts)
        inside = (gauges.min(axis=2) <= self.support).all(axis=1)
        if inside.sum() >= 4:
            gauges = gauges[inside]
        gauges = self._rng.permutation(gauges)[: self._samples]
        return [InferredStep(t, gauges[:, i]) for i, t in enumerate(transitions)]

    def _grow(
        self,
        law: LearnedLaw,
        path: Path,
        t: Transition,
        rivals: Rivals | None,
        end: Array | None,
    ) -> list[Path]:
        """The path one step on: for each form of the offer, choice and reading of the next."""
        mean, covariance = path.means[-1], path.covariances[-1]
        if t.candidates is not None:
            forms = [heard_exactly(np.array(t.candidates), self._n)]
        else:
            forms = law.forms(mean)
        grown = []
        for form in forms:
            size, m = form.g.shape
            for choice in range(size):
                A = self._A + self._B @ form.G[choice]
                centre = A @ mean + self._B @ form.g[choice]
                block = form.R[choice * m : choice * m + m, choice * m : choice * m + m]
                P = A @ covariance @ A.T + self._d_cov + self._B @ block @ self._B.T
                weight = path.weight + form.weight
                ends = self._ends(law, centre, P, rivals, end)
                for gain, mean_next, P_next in ends:
                    grown.append(
                        Path(
                            weight + gain,
                            (*path.means, mean_next),
                            (*path.covariances, P_next),
                            (*path.choices, choice),
                            (*path.forms, form),
                        )
                    )
        return grown

    def _ends(
        self,
        law: LearnedLaw,
        centre: Array,
        P: Array,
        rivals: Rivals | None,
        end: Array | None,
    ) -> list[tuple[float, Array, Array]]:
        """Where a step may have ended, by what was heard there: log weight, mean, covariance."""
        if end is not None:
            R = (self._noise**2 + TINY) * np.eye(self._n)
            mean, covariance, gain = _update(centre, P, np.eye(self._n), end, R)
            return [(gain, mean, covariance)]
        if rivals is None:
            return [(0.0, centre, P)]
        ends = []
        spread = float((self._shape @ P @ self._shape.T).diagonal().max()) ** 0.5
        own = float((self._shape @ self._d_cov @ self._shape.T).diagonal().max()) ** 0.5
        # a state that was uncertain before may lie as much further off
        room = ROOM * self.support * max(spread / own, 1.0) + 3 * self._noise * self._unit
        for reading in rivals.within(centre, P):
            if not len(reading.y):
                ends.append((law.prior(reading, centre), centre, P))
                continue
            mean, covariance, gain = _update(centre, P, reading.C, reading.y, reading.R)
            if float((self._shape @ (mean - centre)).max()) <= room:
                ends.append((law.prior(reading, mean) + gain, mean, covariance))
        return ends

    def _trajectories(self, path: Path, count: int, first: Array, last: Array | None) -> Array:
        """Gauges of ``count`` trajectories along one path, shape (count, steps, M)."""
        steps = len(path.choices)
        gauges = np.empty((count, steps, len(path.forms[0].g)))
        if last is None:
            x = self._sample(np.tile(path.means[-1], (count, 1)), path.covariances[-1])
        else:
            x = np.tile(last, (count, 1))
        for i in range(steps - 1, -1, -1):
            form, choice = path.forms[i], path.choices[i]
            if i == 0:
                before = np.tile(first, (count, 1))
            else:
                A = self._A + self._B @ form.G[choice]
                mean, P = path.means[i], path.covariances[i]
                S = A @ P @ A.T + self._d_cov
                K = np.linalg.solve(S, A @ P).T
                centre = A @ mean + self._B @ form.g[choice]
                before = self._sample(mean + (x - centre) @ K.T, (np.eye(self._n) - K @ A) @ P)
            gauges[:, i] = self._gauges(before, form.at(before), x)
            x = before
        return gauges

    def _gauges(self, x: Array, offers: Array, x_next: Array) -> Array:
        residual = (x_next - x @ self._A.T)[:, None, :] - offers @ self._B.T
        gauges = np.maximum((residual @ self._shape.T).max(axis=2), 0.0)
        return self._bounded(gauges, residual)

    def _sample(self, means: Array, covariance: Array) -> Array:
        values, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
        factor = vectors * np.sqrt(np.maximum(values, 0.0))
        sample: Array = means + self._rng.standard_normal(means.shape) @ factor.T
        return sample


def _update(
    mean: Array, covariance: Array, C: Array, y: Array, R: Array
) -> tuple[Array, Array, float]:
    """Combine a Gaussian with a reading C x = y of covariance R; its log evidence too."""
    S = C @ covariance @ C.T + R
    K = np.linalg.solve(S, C @ covariance).T
    r = y - C @ mean
    posterior = (np.eye(len(mean)) - K @ C) @ covariance
    evidence = -0.5 * (
        float(r @ np.linalg.solve(S, r))
        + float(np.linalg.slogdet(S)[1])
        + len(y) * float(np.log(2 * np.pi))
    )
    return mean + K @ r, (posterior + posterior.T) / 2, evidence
