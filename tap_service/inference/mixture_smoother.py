"""States that were read through noise, inferred together: a mixture forwards, draws backwards.

Given which candidates were applied, everything is linear, and all but the disturbance Gaussian: the
state before a step says where the next one is, more sharply than a noisy reading does. So what is
known of x(k) is a mixture of Gaussians, one for each likely sequence of the last choices. They have
one covariance, for they differ in the choices alone. An offer is a second reading of its state,
where one free program makes it. Afterwards trajectories are drawn backwards (Godsill, Doucet and
West 2004), so that later readings count as well. The disturbance is taken for a Gaussian as wide as
an even one over a multiple of D_e, of which the likeliest is found.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from protocol.arrays import Array
from tap_service.capture.transcript import Transition, steps_in_a_row
from tap_service.inference.inferred import InferredStep
from tap_service.inference.law_pieces import LearnedLaw, learn_law
from tap_service.inference.policy import KnownLaw

PARTS: Final = 64
"""Gaussians kept from step to step."""

SIZES: Final = tuple(np.geomspace(1.0, 1 / 32, 16).tolist())
"""Multiples of D_e over which the disturbance may be spread."""

TRIAL: Final = 160
"""Steps on which they are tried."""

FEW: Final = 12
"""Gaussians kept while they are."""

ANYWHERE: Final = 10.0
"""Standard deviation of a state of which nothing is known, in half-widths of D_e."""

STRAY: Final = 16.0
"""Squared deviations for each number read from which an offer is not the free law's."""

FREE: Final = 1.5
"""Ratio up to which the free law leaves of most offers what noise explains."""

TINY: Final = 1e-12


@dataclass(frozen=True)
class Mixture:
    """What is known of one state: Gaussians of log weights, one covariance for all.

    Shapes (N,), (N, n) and (n, n).
    """

    weights: Array
    means: Array
    P: Array


@dataclass(frozen=True)
class Offered:
    """What a step's offer may have been: candidates, shape (M, m), and the covariance of each."""

    u: Array
    R: Array


class MixtureSmoother:
    """Infers transitions whose states were read through noise.

    Parameters
    ----------
    A, B : array
        Her model.
    shape : array, shape (rows, n)
        H / h of D_e: the gauge of v is the largest entry of ``shape @ v``.
    noise : float
        Standard deviation of what she reads, above 0.
    law : KnownLaw, optional
        As far as the policy gives it.
    samples : int
        Trajectories drawn.

    Attributes
    ----------
    support : float
        Gauge of the largest disturbance, as she takes it.
    """

    def __init__(
        self,
        A: Array,
        B: Array,
        shape: Array,
        noise: float,
        law: KnownLaw | None,
        samples: int,
    ) -> None:
        self._A, self._B, self._shape, self._noise = A, B, shape, noise
        self._n, self._samples = len(A), samples
        self._edge = 1.0 / np.abs(shape).max(axis=0)
        self._known, self._free = law, False
        self._learned: LearnedLaw | None = None
        self._rng = np.random.default_rng(0)
        self._Q = np.eye(self._n)
        self.support = 1.0

    def infer(self, transitions: Sequence[Transition]) -> list[InferredStep]:
        """Infer every transition; the whole transcript that is kept, in one call."""
        runs = [list(run) for run in steps_in_a_row(transitions)]
        pairs = [t for t in transitions if t.x is not None and t.candidates is not None]
        if not pairs:
            return [InferredStep(t, None) for t in transitions]
        x, u = np.array([t.x for t in pairs]), np.array([t.candidates for t in pairs])
        self._learned = learn_law(x, u, self._noise)
        self._free = self._is_free(x, u)
        trial = max(runs, key=len)[:TRIAL]
        evidence: list[float] = []
        for size in SIZES:
            self._spread(size)
            evidence.append(self._forward(trial, FEW)[1])
        self._spread(SIZES[int(np.argmax(evidence))])
        return [step for run in runs for step in self._inferred(run)]

    def _spread(self, size: float) -> None:
        """Take the disturbance for even over so many times D_e."""
        self.support = size
        self._Q = np.diag((size * self._edge) ** 2 / 3)

    # --- what is read -----------------------------------------------------------------------------

    def _is_free(self, x: Array, u: Array) -> bool:
        """Whether one known cost makes the offers, and constraints seldom count."""
        if self._known is None or not self._known.shared:
            return False
        F = self._known.free[0]
        left = np.array([self._known.solved(offer)[0] for offer in u]) - x @ F.T
        expected = self._noise**2 * (F @ F.T + np.eye(len(F)) / u.shape[1])
        squared = np.einsum("si,ij,sj->s", left, np.linalg.inv(expected), left)
        return float(np.median(squared)) <= FREE**2 * len(F)

    def _reading_of(self, t: Transition) -> tuple[Array, Array, Array] | None:
        """What an offer says of its state: C x = y with covariance R.

        By the law as it was learned only where that state was missed: it was learned from such.
        """
        if t.candidates is None:
            return None
        offer = np.array(t.candidates)
        if self._free and self._known is not None:
            F = self._known.free[0]
            return F, self._known.solved(offer)[0], self._noise**2 / len(offer) * np.eye(len(F))
        if self._learned is None or t.x is not None:
            return None
        (reading,) = self._learned.readings(offer)  # of noisy pairs there is one
        return reading.C, reading.y, reading.R

    def _read(self, now: Mixture, t: Transition) -> tuple[Mixture, float]:
        """The mixture after what was heard of a state, and the log evidence of it."""
        evidence = 0.0
        if t.x is not None:
            R = self._noise**2 * np.eye(self._n)
            now, evidence = _updated(now, np.eye(self._n), np.array(t.x), R)
        reading = self._reading_of(t)
        if reading is None:
            return now, evidence
        C, y, R = reading
        off = y - C @ now.means[int(now.weights.argmax())]
        if off @ np.linalg.solve(C @ now.P @ C.T + R, off) > STRAY * len(y):
            return now, evidence  # a constraint was active
        now, gain = _updated(now, C, y, R)
        return now, evidence + gain

    def _offered(self, now: Mixture, t: Transition) -> Offered | None:
        """The step's offer, as it was heard or as the law has it about the likeliest state."""
        m = self._B.shape[1]
        if t.candidates is not None:
            return Offered(np.array(t.candidates), self._noise**2 * np.eye(m))
        if self._learned is None:
            return None
        mean = now.means[int(now.weights.argmax())]
        form = max(self._learned.forms(mean), key=lambda f: f.weight, default=None)
        if form is None:
            return None
        return Offered(form.at(mean[None])[0], form.R[:m, :m])

    # --- forwards ---------------------------------------------------------------------------------

    def _begun(self, t: Transition) -> Mixture:
        nothing = np.diag((ANYWHERE * self._edge) ** 2)
        return self._read(Mixture(np.zeros(1), np.zeros((1, self._n)), nothing), t)[0]

    def _forward(
        self, run: Sequence[Transition], parts: int = PARTS
    ) -> tuple[list[Mixture], float]:
        """What is known of each state by what came before, and the log evidence of it all."""
        now, evidence = self._begun(run[0]), 0.0
        out = [now]
        for before, t in pairwise(run):
            offered = self._offered(now, before)
            if offered is None:
                now = self._begun(t)
            else:
                now, gain = self._read(self._moved(now, offered), t)
                evidence += gain
                if len(now.weights) > parts:
                    kept = np.argpartition(-now.weights, parts)[:parts]
                    now = Mixture(now.weights[kept], now.means[kept], now.P)
            out.append(now)
        return out, evidence

    def _moved(self, now: Mixture, offered: Offered) -> Mixture:
        """The mixture one step on, each candidate as likely."""
        size = len(offered.u)
        means = (now.means @ self._A.T)[:, None] + offered.u @ self._B.T
        P = self._A @ now.P @ self._A.T + self._Q + self._B @ offered.R @ self._B.T
        weights = np.repeat(now.weights - np.log(size), size)
        return Mixture(weights, means.reshape(-1, self._n), P)

    # --- backwards --------------------------------------------------------------------------------

    def _inferred(self, run: Sequence[Transition]) -> list[InferredStep]:
        mixtures, _ = self._forward(run)
        last = run[-1]
        offered = self._offered(mixtures[-1], last)
        end = mixtures[-1] if offered is None else self._moved(mixtures[-1], offered)
        if last.x_next is not None:
            R = self._noise**2 * np.eye(self._n)
            end, _ = _updated(end, np.eye(self._n), np.array(last.x_next), R)
        after = self._drawn(end)
        steps: list[InferredStep] = []
        for now, t in zip(mixtures[::-1], run[::-1], strict=True):
            offered = self._offered(now, t)
            if offered is None:
                steps.append(InferredStep(t, None))
                after = self._drawn(now)
                continue
            before, gauges = self._back(now, offered, after)
            steps.append(InferredStep(t, gauges))
            after = before
        return steps[::-1]

    def _drawn(self, now: Mixture) -> Array:
        """States drawn, shape (S, n)."""
        p = np.exp(now.weights - now.weights.max())
        picked = self._rng.choice(len(p), self._samples, p=p / p.sum())
        return np.asarray(now.means[picked] + self._normal(now.P))

    def _normal(self, P: Array) -> Array:
        """Draws of covariance ``P``, shape (S, rows)."""
        values, vectors = np.linalg.eigh((P + P.T) / 2)
        factor = vectors * np.sqrt(np.maximum(values, 0.0))
        return np.asarray(self._rng.standard_normal((self._samples, len(P))) @ factor.T)

    def _back(self, now: Mixture, offered: Offered, after: Array) -> tuple[Array, Array]:
        """States before ``after``, shape (S, n), and the gauges of that step, shape (S, M)."""
        A, B, u = self._A, self._B, offered.u
        moved = self._moved(now, offered)
        S = np.linalg.inv(moved.P)
        d = after[:, None] - moved.means
        w = moved.weights - 0.5 * np.einsum("sci,ij,scj->sc", d, S, d)
        share = np.exp(w - w.max(axis=1, keepdims=True)).cumsum(axis=1)
        at = self._rng.random((len(after), 1)) * share[:, -1:]
        part, choice = np.divmod((share < at).sum(axis=1), len(u))
        off = after - (now.means[part] @ A.T + u[choice] @ B.T)
        K = now.P @ A.T @ S
        x = now.means[part] + off @ K.T + self._normal(now.P - K @ A @ now.P)
        # of what is left, a part is how the applied input was misread, and the rest d
        left = after - x @ A.T
        L = offered.R @ B.T @ np.linalg.inv(B @ offered.R @ B.T + self._Q)
        rows = np.arange(len(after))
        read = u + self._rng.standard_normal((len(after), *u.shape)) @ _root(offered.R).T
        misread = (left - u[choice] @ B.T) @ L.T + self._normal(offered.R - L @ B @ offered.R)
        read[rows, choice] = u[choice] + misread
        residual = left[:, None] - read @ B.T
        gauges: Array = np.maximum((residual @ self._shape.T).max(axis=2), 0.0)
        return x, gauges


def _root(R: Array) -> Array:
    """A square root of a covariance."""
    values, vectors = np.linalg.eigh((R + R.T) / 2)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _updated(now: Mixture, C: Array, y: Array, R: Array) -> tuple[Mixture, float]:
    """The mixture after a reading C x = y of covariance R, and the log evidence of it."""
    S = C @ now.P @ C.T + R + TINY * np.eye(len(y))
    K = np.linalg.solve(S, C @ now.P).T
    off = y - now.means @ C.T
    log_density = -0.5 * np.einsum("ci,ij,cj->c", off, np.linalg.inv(S), off)
    log_density -= 0.5 * (float(np.linalg.slogdet(S)[1]) + len(y) * float(np.log(2 * np.pi)))
    weights = now.weights + log_density
    total = float(np.logaddexp.reduce(weights) - np.logaddexp.reduce(now.weights))
    P = (np.eye(len(now.P)) - K @ C) @ now.P
    # only differences count: weights are kept near 0
    return Mixture(weights - weights.max(), now.means + off @ K.T, (P + P.T) / 2), total
