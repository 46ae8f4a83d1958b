"""States and symbols from whatever was heard: one Kalman filter under a beam of sequences.

Given which candidates were applied everything is linear: an offer is a reading of its state, for
the law is an affine function of it almost everywhere, and a lost offer follows from the state. So
what is known of x(k) is a mixture of Gaussians, one for each likely sequence of the last symbols,
all of one covariance, for they differ in the symbols alone. Sequences that agree over the last
symbols are merged. Where the law bends an offer says nothing of the state. The disturbance is
bounded: what that says beyond its variance is weighed reading by reading, exactly where the state
before was known. Afterwards trajectories are drawn backwards (Godsill, Doucet and West 2004), so
that what came later counts as well.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from protocol.arrays import Array, Integers
from tap_service.capture.transcript import Transition, steps_in_a_row
from tap_service.inference.affine_law import AffineLaw
from tap_service.inference.bounded import BoundedRows
from tap_service.inference.fitted_shape import Shape, residuals_of
from tap_service.inference.inferred import InferredStep

PARTS: Final = 192
"""Gaussians kept from step to step."""

LAG: Final = 4096
"""Sequences are merged that agree over as many of the last symbols as there are so many of."""

SIZES: Final = tuple(np.geomspace(1.0, 1 / 32, 11).tolist())
"""Multiples of D_e over which the disturbance may be spread."""

FINER: Final = (0.82, 0.9, 1.0, 1.1, 1.2)
"""Times the best of them, which are then tried."""

EXACT: Final = 1e-5
"""Over the spread of the offers: up to which error a law is exact."""

BEYOND: Final = 1.3
"""Ratio by which the disturbance may seem to reach beyond what it can."""

TRIAL: Final = 160
"""Steps on which they are tried."""

FEW: Final = 24
"""Gaussians kept while they are."""

ANYWHERE: Final = 10.0
"""Standard deviation of a state of which nothing is known, in half-widths of D_e."""

STRAY: Final = 0.03
"""Share of the offers that are not as the law says."""

DOUBT: Final = 3.0
"""By which the covariance of a state grows that a stray offer contradicts."""

ROOM: Final = 5.0
"""Over the spread of the offers where nothing is known of the state: where those may lie."""

ENOUGH: Final = 16
"""Steps heard whole from which the disturbance is measured."""

PROPOSALS: Final = 6
"""States drawn backwards for each trajectory, of which one is kept by the disturbance's bounds."""

TINY: Final = 1e-12


@dataclass(frozen=True)
class Mixture:
    """What is known of one state: Gaussians of log weights, one covariance for all.

    Shapes (N,), (N, n) and (n, n); ``past`` numbers the last symbols, shape (N,).
    """

    weights: Array
    means: Array
    P: Array
    past: Integers

    def best(self, count: int) -> "Mixture":
        """The heaviest."""
        if len(self.weights) <= count:
            return self
        kept = np.argpartition(-self.weights, count)[:count]
        return Mixture(self.weights[kept], self.means[kept], self.P, self.past[kept])

    def merged(self) -> "Mixture":
        """Those of one past as one."""
        order = np.argsort(self.past, kind="stable")
        first = np.flatnonzero(np.diff(self.past[order], prepend=-1))
        if len(first) == len(order):
            return self
        w = np.exp(self.weights - self.weights.max())[order]
        total = np.add.reduceat(w, first)
        means = np.add.reduceat(w[:, None] * self.means[order], first) / np.maximum(
            total[:, None], 1e-300
        )
        weights = np.log(np.maximum(total, 1e-300)) + self.weights.max()
        return Mixture(weights, means, self.P, self.past[order][first])


@dataclass(frozen=True)
class Move:
    """How a step may go, for each candidate: x(k+1) = A_i x(k) + c_i + d + error.

    Parameters
    ----------
    A : array, shape (M, n, n)
    c : array, shape (M, n)
    R : array, shape (m, m)
        Covariance of the input's error.
    weight : float
        Log probability.
    misread : bool
        Whether each candidate has an error of its own.
    """

    A: Array
    c: Array
    R: Array
    weight: float = 0.0
    misread: bool = False


class BeamSmoother:
    """Infers transitions.

    Parameters
    ----------
    A, B : array
        Her model.
    told : array, shape (rows, n)
        H / h of D_e.
    shape : Shape
        In which candidates are measured.
    noise : float
        Standard deviation of what she reads.
    law : AffineLaw, optional
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
        told: Array,
        shape: Shape,
        noise: float,
        law: AffineLaw | None,
        samples: int,
    ) -> None:
        self._A, self._B, self._shape, self._noise = A, B, shape, noise
        self._n, self._samples, self._law = len(A), samples, law
        self._edge = 1.0 / np.abs(told).max(axis=0)
        self._nothing = np.diag((ANYWHERE * self._edge) ** 2)
        self._rng = np.random.default_rng(0)
        self.support = 1.0
        self._exact = False
        self._spread(self._edge)

    def infer(self, transitions: Sequence[Transition]) -> list[InferredStep]:
        """Infer every transition; the whole transcript that is kept, in one call."""
        runs = [list(run) for run in steps_in_a_row(transitions)]
        if not any(t.x is not None or t.candidates is not None for t in transitions):
            return [InferredStep(t, None) for t in transitions]
        return [step for run in runs for step in self._inferred(run)]

    @property
    def exact(self) -> bool:
        """Whether the law is shared and mostly as the policy has it, to the last digit."""
        return self._exact

    def learn(
        self, transitions: Sequence[Transition], run: Sequence[Transition], most: float
    ) -> None:
        """How far the disturbance reaches.

        By the steps heard whole, or as the multiple of D_e that makes a ``run`` likeliest; where
        that is beyond the ``most`` that it can be, the law says something else.
        """
        law = self._law
        self._exact = law is not None and law.shared and law.error <= EXACT * law.spread
        if not self._measured(transitions):
            self._learn(run[:TRIAL])
            if self.support > BEYOND * most:
                self._exact = False
                self.support = most
                self._spread(most * self._edge)

    def _learn(self, trial: Sequence[Transition]) -> None:
        """The multiple of D_e that makes what was heard likeliest."""

        def evidence(size: float) -> float:
            self._spread(size * self._edge)
            return self._forward(trial, FEW)[1]

        best = max(SIZES, key=evidence)
        self.support = max((best * ratio for ratio in FINER), key=evidence)
        self._spread(self.support * self._edge)

    def _measured(self, transitions: Sequence[Transition]) -> bool:
        """The disturbance's reach from steps heard whole and exactly, if there are enough."""
        whole = [t for t in transitions if t.whole]
        if self._noise or len(whole) < ENOUGH:
            return False
        left = residuals_of(self._A, self._B, whole)
        gauges = self._gauges(left)
        nearest = left[np.arange(len(whole)), gauges.argmin(axis=1)]
        self.support = float(gauges.min(axis=1).max()) * (1 + 2 / len(whole))
        self._spread(np.abs(nearest).max(axis=0) * (1 + 2 / len(whole)))
        return True

    def _spread(self, reach: Array) -> None:
        """Take the disturbance for even over so much in each coordinate."""
        self._reach = np.maximum(reach, TINY)
        self._Q = np.diag(self._reach**2 / 3)
        self._whole = BoundedRows(np.eye(self._n), self._reach)
        self._rows: dict[bytes, BoundedRows] = {}

    # --- forwards ---------------------------------------------------------------------------------

    def _begun(self, t: Transition) -> tuple[Mixture, bool, float]:
        past = np.zeros(1, dtype=int)
        start = Mixture(np.zeros(1), np.zeros((1, self._n)), self._nothing, past)
        return self._heard(start, t, None)

    def _forward(
        self, run: Sequence[Transition], parts: int = PARTS
    ) -> tuple[list[Mixture], float, list[Move | None]]:
        """What is known of each state by what came before, the log evidence, and the moves."""
        now, free, _ = self._begun(run[0])
        evidence = 0.0
        out: list[Mixture] = [now]
        moves: list[Move | None] = []
        for before, t in pairwise(run):
            ways = self._ways(now, before, free)
            if not ways:
                now, free, _ = self._begun(t)
                moves.append(None)
            else:
                move, now, free, gain = self._likeliest(now, ways, t)
                now = now.merged().best(parts)
                evidence += gain
                moves.append(move)
            out.append(now)
        ways = self._ways(now, run[-1], free)
        after = replace(run[-1], x=run[-1].x_next, candidates=None)
        moves.append(self._likeliest(now, ways, after)[0] if ways else None)
        return out, evidence, moves

    def _likeliest(
        self, now: Mixture, ways: Sequence[Move], t: Transition
    ) -> tuple[Move, Mixture, bool, float]:
        """The way that explains best what was heard after it, and what is known then."""
        tried = []
        for move in ways if t.x is not None or t.candidates is not None else ways[:1]:
            moved = self._moved(now, move)
            found, free, gain = self._heard(moved, t, moved.P - self._Q)
            tried.append((move, found, free, gain + move.weight))
        return max(tried, key=lambda one: one[3])

    def _ways(self, now: Mixture, t: Transition, free: bool) -> list[Move]:
        """How the step may go: by its offer as it was heard, or by the law."""
        law, m = self._law, self._B.shape[1]
        forms = [] if law is None else law.forms(now.means[int(now.weights.argmax())])
        if t.candidates is not None:
            u, R = np.array(t.candidates), self._noise**2 * np.eye(m)
            size = len(u)
            if law is not None and law.shared:
                u, R = law.v_of(u) + law.g, R / size
                forms = forms[:1]
            if law is None or not (law.shared and free and self._noise > law.error):
                A = np.broadcast_to(self._A, (size, self._n, self._n))
                misread = bool(self._noise) and (law is None or not law.shared)
                return [Move(A, u @ self._B.T, R, misread=misread)]
        if law is None:
            return []
        A = self._A + np.einsum("nm,imk->ink", self._B, law.G)
        eye = np.eye(m)
        return [Move(A, g @ self._B.T, error**2 * eye, weight) for weight, g, error in forms]

    def _moved(self, now: Mixture, move: Move) -> Mixture:
        """The mixture one step on, each candidate as likely."""
        size = len(move.c)
        means = np.einsum("ink,ck->cin", move.A, now.means) + move.c
        P = np.einsum("iab,bc,idc->ad", move.A, now.P, move.A) / size
        P = P + self._Q + self._B @ move.R @ self._B.T
        weights = np.repeat(now.weights - np.log(size), size)
        past = (now.past[:, None] * size + np.arange(size)) % _last(size)
        return Mixture(weights, means.reshape(-1, self._n), (P + P.T) / 2, past.ravel())

    def _heard(self, now: Mixture, t: Transition, own: Array | None) -> tuple[Mixture, bool, float]:
        """The mixture after what was heard of a state, whether its offer is free, log evidence.

        ``own`` is its covariance but for the last disturbance, which is bounded; None where there
        was none.
        """
        evidence, free = 0.0, False
        if t.x is not None:
            R = (self._noise**2 + TINY) * np.eye(self._n)
            bounded = None if own is None else self._whole
            now, evidence = self._updated(now, np.eye(self._n), np.array(t.x), R, bounded, own)
            own = None
        if t.candidates is None or self._law is None:
            return now, free, evidence
        C, y, variance = self._law.reading(np.array(t.candidates), self._noise)
        for rows in self._law.blocks:
            if not len(rows):
                continue
            R = np.diag(variance[rows])
            bounded = None if own is None else self._bounded(C[rows])
            read, gain = self._updated(now, C[rows], y[rows], R, bounded, own)
            wide = np.sqrt(np.einsum("ri,ij,rj->r", C[rows], self._nothing, C[rows]))
            astray = np.log(STRAY) - float(np.log(ROOM * (wide + self._law.spread)).sum())
            if gain + np.log(1 - STRAY) > astray:
                now, own, free = read, None, True
                evidence += gain + np.log(1 - STRAY)
            else:
                evidence += astray
                if t.x is None:  # or what is believed of the state is wrong
                    more = DOUBT if (now.P.diagonal() < self._nothing.diagonal()).all() else 1.0
                    now, own = replace(now, P=more * now.P), None
        return now, free, evidence

    def _bounded(self, C: Array) -> BoundedRows:
        key = C.tobytes()
        if key not in self._rows:
            self._rows[key] = BoundedRows(C, self._reach)
        return self._rows[key]

    def _updated(
        self,
        now: Mixture,
        C: Array,
        y: Array,
        R: Array,
        bounded: BoundedRows | None,
        own: Array | None,
    ) -> tuple[Mixture, float]:
        """The mixture after a reading C x = y of covariance R, and the log evidence of it."""
        S = C @ now.P @ C.T + R
        K = np.linalg.solve(S, C @ now.P).T
        off = y - now.means @ C.T
        log_density = -0.5 * np.einsum("ci,ij,cj->c", off, np.linalg.inv(S), off)
        log_density -= 0.5 * (float(np.linalg.slogdet(S)[1]) + len(y) * float(np.log(2 * np.pi)))
        if bounded is not None and own is not None:
            wide = np.sqrt(np.maximum(np.diag(C @ own @ C.T + R), 0.0))
            log_density += bounded.log_ratio(off, wide)
        weights = now.weights + log_density
        total = float(np.logaddexp.reduce(weights) - np.logaddexp.reduce(now.weights))
        P = (np.eye(len(now.P)) - K @ C) @ now.P
        # only differences count: weights are kept near 0
        means = now.means + off @ K.T
        return Mixture(weights - weights.max(), means, (P + P.T) / 2, now.past), total

    # --- backwards --------------------------------------------------------------------------------

    def _inferred(self, run: Sequence[Transition]) -> list[InferredStep]:
        mixtures, _, moves = self._forward(run)
        last, move = run[-1], moves[-1]
        end = mixtures[-1] if move is None else self._moved(mixtures[-1], move)
        if last.x_next is not None and move is not None:
            after = replace(last, x=last.x_next, candidates=None)
            end, _, _ = self._heard(end, after, end.P - self._Q)
        drawn = self._drawn(end)
        steps: list[InferredStep] = []
        for now, t, how in zip(mixtures[::-1], run[::-1], moves[::-1], strict=True):
            if how is None:
                steps.append(InferredStep(t, None))
                drawn = self._drawn(now)
                continue
            before, gauges = self._back(now, how, drawn)
            if t.whole and not self._noise:
                gauges = self._gauges(residuals_of(self._A, self._B, [t]))
            steps.append(InferredStep(t, gauges))
            drawn = before
        return steps[::-1]

    def _drawn(self, now: Mixture) -> Array:
        """States drawn, shape (S, n)."""
        p = np.exp(now.weights - now.weights.max())
        picked = self._rng.choice(len(p), self._samples, p=p / p.sum())
        return now.means[picked] + self._normal(now.P, (self._samples,))

    def _normal(self, P: Array, shape: tuple[int, ...]) -> Array:
        """Draws of covariance ``P``."""
        out: Array = self._rng.standard_normal((*shape, len(P))) @ _root(P).T
        return out

    def _back(self, now: Mixture, move: Move, after: Array) -> tuple[Array, Array]:
        """States before ``after``, shape (S, n), and the gauges of that step, shape (S, M)."""
        size, count = len(move.c), len(after)
        noise = self._Q + self._B @ move.R @ self._B.T
        log = np.empty((count, len(now.weights), size))
        gains = []
        for i in range(size):
            S = move.A[i] @ now.P @ move.A[i].T + noise
            W = np.linalg.cholesky(np.linalg.inv(S))
            a, b = after @ W, (now.means @ move.A[i].T + move.c[i]) @ W
            apart = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2 * a @ b.T
            log[:, :, i] = now.weights - 0.5 * apart + np.log(np.diag(W)).sum()
            gains.append(now.P @ move.A[i].T @ np.linalg.inv(S))
        flat = log.reshape(count, -1)
        share = np.exp(flat - flat.max(axis=1, keepdims=True)).cumsum(axis=1)
        u = self._rng.random((PROPOSALS, count)) * share[:, -1]
        at = np.array([np.searchsorted(row, u[:, s]) for s, row in enumerate(share)]).T
        part, choice = np.divmod(np.minimum(at, flat.shape[1] - 1), size)
        # of shape (PROPOSALS, S, n)
        mean = now.means[part]
        off = after - (np.einsum("psab,psb->psa", move.A[choice], mean) + move.c[choice])
        x = mean + np.einsum("psab,psb->psa", np.array(gains)[choice], off)
        for i in range(size):
            left = now.P - gains[i] @ move.A[i] @ now.P
            mine = choice == i
            x[mine] += self._normal((left + left.T) / 2, (int(mine.sum()),))
        d = after - np.einsum("psab,psb->psa", move.A[choice], x) - move.c[choice]
        wide = np.sqrt(np.maximum(np.diag(self._B @ move.R @ self._B.T), 0.0))
        weight = self._whole.log_ratio(d.reshape(-1, self._n), wide).reshape(choice.shape)
        gumbel = weight + self._rng.gumbel(size=weight.shape)
        kept = (gumbel.argmax(axis=0), np.arange(count))
        x, choice, d = x[kept], choice[kept], d[kept]
        # of what is left, a part is how the applied input was misread
        d = d @ (self._Q @ np.linalg.inv(noise)).T
        u = np.einsum("imk,sk->sim", self._inputs(move), x) + self._constant(move)
        apart = u[np.arange(count), choice][:, None] - u
        if move.misread:
            apart += self._normal(2 * move.R, apart.shape[:2])
            apart[np.arange(count), choice] = 0.0
        residual = d[:, None] + apart @ self._B.T
        return x, self._gauges(residual)

    def _gauges(self, residuals: Array) -> Array:
        """Of residuals of shape (..., M, n)."""
        gauges = np.maximum((residuals @ self._shape.rows.T).max(axis=-1), 0.0)
        return self._shape.bounded(gauges, residuals)

    def _inputs(self, move: Move) -> Array:
        """How the inputs depend on the state, shape (M, m, n)."""
        out: Array = np.einsum("mn,ink->imk", np.linalg.pinv(self._B), move.A - self._A)
        return out

    def _constant(self, move: Move) -> Array:
        """Their constant parts, shape (M, m)."""
        return move.c @ np.linalg.pinv(self._B).T


def _root(R: Array) -> Array:
    """A square root of a covariance."""
    values, vectors = np.linalg.eigh((R + R.T) / 2)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _last(size: int) -> int:
    """How many sequences there are of the last symbols that count."""
    out = size
    while out * size <= LAG:
        out *= size
    return out
