"""States and symbols from whatever was heard: Kalman filters under a beam of hypotheses.

Given which candidates were applied, and by which piece of the law each offer came about, everything
is linear: an offer is a reading of its state, and a lost offer follows from the state. So what is
known of x(k) is a mixture of Gaussians, one for each likely hypothesis. Hypotheses that agree over
the last symbols are merged. An offer that no piece explains says nothing of its state. The
disturbance is bounded: what that says beyond its variance is weighed exactly where the state before
was known. Afterwards trajectories are drawn backwards (Godsill, Doucet and West 2004), so that what
came later counts as well.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from protocol.arrays import Array, Flags, Indices, Integers
from tap_service.capture.transcript import Transition, steps_in_a_row
from tap_service.inference.fitted_shape import Shape, residuals_of
from tap_service.inference.law import ANYTHING, AffineLaw, Item, PlanarLaw
from tap_service.inference.verdicts import InferredStep

CELLS: Final = 1024
"""Of a density, over four times its support."""

NEVER: Final = -30.0
"""Log ratio of what cannot be."""

GAUSSIAN: Final = 0.7
"""Deviation of an error, over the reach of a disturbance, from which their sum is as Gaussian."""

STEPS: Final = 12.0
"""Deviations of errors are told apart by a twelfth of a doubling."""


class BoundedRows:
    """Readings C d + e: d even over a box, e Gaussian; their densities over the Gaussian ones.

    Row by row, so that it is exact where e is small and rows are coordinates.

    Parameters
    ----------
    C : array, shape (r, n)
    reach : array, shape (n,)
    """

    def __init__(self, C: Array, reach: Array) -> None:
        self._reach = (np.abs(C) * reach).sum(axis=1)
        self._widths = np.abs(C) * reach
        self._tables: dict[tuple[int, int], tuple[Array, Array]] = {}

    def log_ratio(self, off: Array, wide: Array) -> Array:
        """Log of the density over the Gaussian's, summed over rows; shape (...,).

        Parameters
        ----------
        off : array, shape (..., r)
        wide : array, shape (..., r)
            Deviation of e, or what broadcasts to it.
        """
        out = np.zeros(off.shape[:-1])
        for r, reach in enumerate(self._reach):
            least = 16 * reach / CELLS
            level = STEPS * np.log2(np.maximum(wide[..., r], least) / reach)
            level = np.round(np.minimum(level, STEPS)).astype(int)
            level = np.broadcast_to(level, out.shape)
            for step in np.unique(level).tolist():
                deviation = reach * 2 ** (step / STEPS)
                if deviation < GAUSSIAN * reach:
                    mine = level == step
                    at, log = self._table(r, step, deviation)
                    out[mine] += np.interp(off[mine, r], at, log, left=NEVER, right=NEVER)
        return out

    def _table(self, r: int, step: int, deviation: float) -> tuple[Array, Array]:
        """Places and the log ratio there."""
        if (r, step) not in self._tables:
            reach, widths = self._reach[r], self._widths[r]
            length = 8 * reach
            grid = 2 * np.pi * np.fft.rfftfreq(CELLS, length / CELLS)
            wave = np.prod(np.sinc(np.outer(widths, grid) / np.pi), axis=0)
            wave = wave * np.exp(-0.5 * (grid * deviation) ** 2)
            density = np.fft.fftshift(np.fft.irfft(wave, CELLS)) * CELLS / length
            at = (np.arange(CELLS) - CELLS // 2) * length / CELLS
            variance = (widths**2).sum() / 3 + deviation**2
            gauss = -0.5 * at**2 / variance - 0.5 * np.log(2 * np.pi * variance)
            # beyond the support it falls as a Gaussian of the other deviation
            beyond = np.maximum(np.abs(at) - reach, 0.0) / deviation
            least = -0.5 * beyond**2 - np.log(2 * reach) + np.where(beyond > 0, -1.0, 0.0)
            log = np.where(density > 1e-6 / reach, np.log(np.maximum(density, 1e-300)), least)
            self._tables[r, step] = at, np.maximum(log - gauss, NEVER)
        return self._tables[r, step]


PARTS: Final = 192
"""Gaussians kept from step to step."""

LAG: Final = 4096
"""Hypotheses are merged that agree over as many of the last symbols as there are so many of."""

NEGLIGIBLE: Final = 9.0
"""Log weight below the largest from which on a Gaussian is dropped."""

FAR: Final = 11.0
"""The same of ways in which an offer came about, whose bounds were not looked at."""

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

ENOUGH: Final = 16
"""Steps heard whole from which the disturbance is measured."""

PROPOSALS: Final = 6
"""States drawn backwards for each trajectory, of which one is kept by the disturbance's bounds."""

NODES: Final = np.linspace(-2.55, 2.55, 16)
"""Places along the direction that a reading leaves open, in standard deviations."""

NARROW: Final = 0.003
"""Variance that such a cut leaves at least, over the one before."""

DOUBT: Final = 3.0
"""By which the covariance of a state grows that a stray offer contradicts."""

TINY: Final = 1e-12


@dataclass(frozen=True)
class Mixture:
    """What is known of one state: Gaussians of log weights.

    Shapes (N,), (N, n) and (N, n, n); ``past`` numbers the last symbols, shape (N,); ``lawful``
    says whether a hypothesis has the offer come about by the law, shape (N,).
    """

    weights: Array
    means: Array
    P: Array
    past: Integers
    lawful: Flags

    def __getitem__(self, kept: object) -> "Mixture":
        return Mixture(*(part[kept] for part in vars(self).values()))

    def best(self, count: int) -> "Mixture":
        """The heaviest first, none of them negligible; the largest weight is 0."""
        top = float(self.weights.max())
        found = replace(self, weights=self.weights - top)
        kept = np.argsort(-found.weights, kind="stable")[:count]
        return found[kept[found.weights[kept] > -NEGLIGIBLE]]

    def merged(self) -> "Mixture":
        """Those of one past as one."""
        key = 2 * self.past + self.lawful
        order = np.argsort(key, kind="stable")
        first = np.flatnonzero(np.diff(key[order], prepend=-1))
        if len(first) == len(order):
            return self
        top = float(self.weights.max())
        w = np.exp(self.weights - top)[order]
        total = np.maximum(np.add.reduceat(w, first), 1e-300)
        group = np.zeros(len(order), dtype=int)
        group[first[1:]] = 1
        group = group.cumsum()
        means = np.add.reduceat(w[:, None] * self.means[order], first) / total[:, None]
        off = self.means[order] - means[group]
        P = self.P[order] + off[:, :, None] * off[:, None]
        P = np.add.reduceat(w[:, None, None] * P, first) / total[:, None, None]
        some = order[first]
        return Mixture(np.log(total) + top, means, P, self.past[some], self.lawful[some])

    @classmethod
    def together(cls, parts: Sequence["Mixture"]) -> "Mixture":
        """All Gaussians of several."""
        columns = zip(*(vars(part).values() for part in parts), strict=True)
        return cls(*(np.concatenate(column) for column in columns))


@dataclass(frozen=True)
class Move:
    """How a step may go: x(k+1) = A x(k) + c + d + B e, for each Gaussian and candidate.

    Parameters
    ----------
    A : array, shape (N, M, n, n)
    c : array, shape (N, M, n)
    error : array, shape (N,)
        Standard deviation of e.
    weight : float
        Log probability.
    misread : array, shape (N,)
        Whether each candidate has an error of its own.
    """

    A: Array
    c: Array
    error: Array
    weight: float
    misread: Flags


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
    law : AffineLaw or PlanarLaw, optional
    samples : int
        Trajectories drawn.

    Attributes
    ----------
    support : float
        Gauge of the largest disturbance, as she takes it.
    exact : bool
        Whether the law is shared and mostly as the policy has it, to the last digit.
    """

    def __init__(
        self,
        A: Array,
        B: Array,
        told: Array,
        shape: Shape,
        noise: float,
        law: AffineLaw | PlanarLaw | None,
        samples: int,
    ) -> None:
        self._A, self._B, self._shape, self._noise = A, B, shape, noise
        self._n, self._samples, self._law = len(A), samples, law
        self._edge = 1.0 / np.abs(told).max(axis=0)
        self._nothing = np.diag((ANYWHERE * self._edge) ** 2)
        self._rng = np.random.default_rng(0)
        self.support = 1.0
        self._shared = isinstance(law, AffineLaw) and law.shared
        self.exact = law is not None and self._shared and law.error <= EXACT * law.spread
        self._spread(self._edge)

    def infer(self, transitions: Sequence[Transition]) -> list[InferredStep]:
        """Infer every transition; the whole transcript that is kept, in one call."""
        runs = [list(run) for run in steps_in_a_row(transitions)]
        if not any(t.x is not None or t.candidates is not None for t in transitions):
            return [InferredStep(t, None) for t in transitions]
        return [step for run in runs for step in self._inferred(run)]

    def learn(
        self, transitions: Sequence[Transition], run: Sequence[Transition], most: float
    ) -> None:
        """How far the disturbance reaches.

        By the steps heard whole, or as the multiple of D_e that makes a ``run`` likeliest, at
        ``most`` so much.
        """
        if not self._measured(transitions):
            self._learn(run[:TRIAL])
            if self.support > BEYOND * most:
                self.exact = False
                self.support = most
                self._spread(most * self._edge)

    def evidence(self, run: Sequence[Transition], size: float) -> float:
        """Log evidence of a run where the disturbance is spread over ``size`` times D_e."""
        self._spread(size * self._edge)
        return self._forward(run, FEW)[1]

    def _learn(self, trial: Sequence[Transition]) -> None:
        """The multiple of D_e that makes what was heard likeliest."""
        best = max(SIZES, key=lambda size: self.evidence(trial, size))
        finer = [best * ratio for ratio in FINER]
        self.support = max(finer, key=lambda size: self.evidence(trial, size))
        self._spread(self.support * self._edge)

    def _measured(self, transitions: Sequence[Transition]) -> bool:
        """The disturbance's reach from steps heard whole and exactly, if there are enough."""
        whole = [t for t in transitions if t.whole]
        if self._noise or len(whole) < ENOUGH:
            return False
        left = residuals_of(self._A, self._B, whole)
        gauges = self._shape.gauges(left)
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

    def _begun(self, t: Transition) -> Mixture:
        nothing = Mixture(
            np.zeros(1), np.zeros((1, self._n)), self._nothing[None], np.zeros(1, dtype=int),
            np.zeros(1, dtype=bool),
        )  # fmt: skip
        return self._heard(nothing, t, None)

    def _forward(
        self, run: Sequence[Transition], parts: int = PARTS
    ) -> tuple[list[Mixture], float, list[list[Move]]]:
        """What is known of each state by what came before, the log evidence, and the moves."""
        now = self._begun(run[0]).merged().best(parts)
        evidence = 0.0
        out: list[Mixture] = [now]
        moves: list[list[Move]] = []
        for before, t in pairwise(run):
            ways = self._ways(now, before)
            moves.append(ways)
            if not ways:
                now = self._begun(t)
            else:
                level = np.logaddexp.reduce(now.weights)
                now = self._after(now, ways, t)
                evidence += float(np.logaddexp.reduce(now.weights) - level)
            now = now.merged().best(parts)
            out.append(now)
        moves.append(self._ways(now, run[-1]))
        return out, evidence, moves

    def _after(self, now: Mixture, ways: Sequence[Move], t: Transition) -> Mixture:
        """The mixture one step on, after what was heard there."""
        moved, own = zip(*(self._moved(now, move) for move in ways), strict=True)
        together = Mixture.together(moved)
        if t.x is not None and not self._noise:
            return self._at(together, t, np.concatenate(own))
        return self._heard(together, t, np.concatenate(own))

    def _ways(self, now: Mixture, t: Transition) -> list[Move]:
        """How the step may go: by its offer as it was heard, or by the law."""
        law, count = self._law, len(now.weights)
        if t.candidates is not None:
            u, noise = np.array(t.candidates), self._noise
            size = len(u)
            if noise and isinstance(law, AffineLaw) and law.shared:
                u, noise = law.averaged(u), noise / float(np.sqrt(size))
            A = np.broadcast_to(self._A, (count, size, self._n, self._n))
            c = np.broadcast_to(u @ self._B.T, (count, size, self._n))
            error = np.full(count, noise)
            misread = np.full(count, bool(noise) and not self._shared)
            if law is not None and noise > law.error:
                form = law.forms(now.means)[0]
                which = now.lawful
                A = np.where(which[:, None, None, None], self._A + self._B @ form.G, A)
                c = np.where(which[:, None, None], form.g @ self._B.T, c)
                error = np.where(which, form.error, error)
                misread = misread & ~which
            return [Move(A, c, error, 0.0, misread)]
        if law is None:
            return []
        out = []
        for form in law.forms(now.means):
            A, c = self._A + self._B @ form.G, form.g @ self._B.T
            A = np.broadcast_to(A, (count, *A.shape[1:]))
            c = np.broadcast_to(c, (count, *c.shape[1:]))
            no = np.zeros(count, dtype=bool)
            out.append(Move(A, c, np.full(count, form.error), form.weight, no))
        return out

    def _moved(self, now: Mixture, move: Move) -> tuple[Mixture, Array]:
        """The mixture one step on, each candidate as likely; its covariance but for d."""
        count, size = move.c.shape[:2]
        means = np.einsum("cink,ck->cin", move.A, now.means) + move.c
        own = move.A @ now.P[:, None] @ move.A.swapaxes(2, 3)
        own = own + (move.error**2)[:, None, None, None] * (self._B @ self._B.T)
        own = own.reshape(-1, self._n, self._n)
        weights = np.repeat(now.weights - np.log(size) + move.weight, size)
        past = (now.past[:, None] * size + np.arange(size)) % _last(size)
        lawful = np.zeros(count * size, dtype=bool)
        mixture = Mixture(weights, means.reshape(-1, self._n), own + self._Q, past.ravel(), lawful)
        return mixture, own

    def _at(self, now: Mixture, t: Transition, own: Array) -> Mixture:
        """The one state that was heard exactly."""
        x = np.array(t.x)
        off = x - now.means
        weights = now.weights + _log_normal(off, now.P + TINY * np.eye(self._n))
        weights += self._whole.log_ratio(off, _deviations(own))
        top = int(weights.argmax())
        total = np.array([np.logaddexp.reduce(weights)])
        tiny = TINY * np.eye(self._n)[None]
        return Mixture(total, x[None], tiny, now.past[top : top + 1], np.ones(1, dtype=bool))

    def _heard(self, now: Mixture, t: Transition, own: Array | None) -> Mixture:
        """The mixture after what was heard of a state, weighed by it.

        ``own`` is its covariance but for the last disturbance, which is bounded; None where there
        was none.
        """
        origin = None if own is None else Origin(now.means, own)
        if t.x is not None:
            off = np.array(t.x) - now.means
            now = _updated(now, np.eye(self._n), off, np.full(self._n, self._noise**2 + TINY))
            if origin is not None:
                ratio = self._whole.log_ratio(off, np.hypot(origin.wide, self._noise))
                now = replace(now, weights=now.weights + ratio)
            origin = None
        if t.candidates is None or self._law is None:
            return now
        found = [(replace(now, lawful=np.ones(len(now.weights), dtype=bool)), origin)]
        items = self._law.items(np.array(t.candidates), self._noise)
        rows = 0
        for item in items:
            rows += item.y.shape[1]
            last = item is items[-1]
            more = DOUBT if t.x is None else 1.0
            found = [
                part
                for before, since in found
                for part in (
                    self._explained(before, item, since, self._n - rows, last=last),
                    (self._astray(before, item, more), since),
                )
            ]
        return Mixture.together([part for part, _ in found])

    def _explained(
        self, now: Mixture, item: Item, origin: "Origin | None", left_open: int, *, last: bool
    ) -> tuple[Mixture, "Origin | None"]:
        """The mixture by each way in which a part of an offer came about.

        ``left_open`` counts the directions in which nothing was read. Last, where each came from.
        """
        if not len(now.weights):
            return now, origin
        C = item.C
        off = item.y - np.einsum("pri,ci->cpr", C, now.means)
        S = C @ now.P[:, None] @ C.swapaxes(1, 2) + item.variance * np.eye(C.shape[1])
        weights = now.weights[:, None] + _log_normal(off, S)
        if origin is not None and last and left_open > 1:
            assert len(C) == 1
            across = np.sqrt(np.einsum("ri,cij,rj->cr", C[0], origin.own, C[0]))
            weights += self._bounded(C[0]).log_ratio(off[:, 0], across)[:, None]
        source, way = np.nonzero(weights > weights.max() - FAR)
        C, P = C[way], now.P[source]
        K = np.linalg.solve(S[source, way], C @ P).swapaxes(1, 2)
        P = P - K @ C @ P
        means = now.means[source] + np.einsum("cir,cr->ci", K, off[source, way])
        read = replace(
            now[source], weights=weights[source, way], means=means, P=(P + P.swapaxes(1, 2)) / 2
        )
        since = None if origin is None else origin.of(source)
        if left_open > 1:
            return read, since
        read, kept = self._along(read, way, item, since if last else None)
        return read, None if since is None else since.of(kept)

    def _astray(self, now: Mixture, item: Item, more: float) -> Mixture:
        """The mixture if a part of an offer is anything; what is believed may be wrong then."""
        assert self._law is not None
        C = item.C[0]
        off = item.y[0] - now.means @ C.T
        S = C @ now.P @ C.T + (ANYTHING * self._law.spread) ** 2 * np.eye(len(C))
        astray = np.log(STRAY) + _log_normal(off, S)
        known = np.all(now.P.diagonal(axis1=1, axis2=2) < self._nothing.diagonal(), axis=1)
        P = np.where(known[:, None, None], more, 1.0) * now.P
        stray = np.zeros(len(now.weights), dtype=bool)
        return replace(now, weights=now.weights + astray, P=P, lawful=stray)

    def _along(
        self, now: Mixture, way: Indices, item: Item, origin: "Origin | None"
    ) -> tuple[Mixture, Flags]:
        """Gaussians of which one direction is open, cut off where the law or the bounds say so.

        Last, which of them are left.
        """
        values, vectors = np.linalg.eigh(now.P)
        axis = vectors[:, :, -1] * np.sqrt(np.maximum(values[:, -1:], 0.0))
        x = now.means[:, None] + NODES[:, None] * axis[:, None]
        log = np.broadcast_to(-0.5 * NODES**2, x.shape[:2])
        if origin is not None:
            log = log + self._whole.log_ratio(x - origin.means[:, None], origin.wide[:, None])
        if item.holds is not None:
            log = np.where(item.holds(x, way), log, -np.inf)
        total = np.logaddexp.reduce(log, axis=1)
        left = total > -np.inf
        w = np.exp(log[left] - total[left, None])
        middle = w @ NODES
        part, axis = now[left], axis[left]
        spread = np.maximum(w @ NODES**2 - middle**2, NARROW) - 1.0
        P = part.P + spread[:, None, None] * axis[:, :, None] * axis[:, None]
        weights = part.weights + total[left] - float(np.logaddexp.reduce(-0.5 * NODES**2))
        return replace(part, weights=weights, means=part.means + middle[:, None] * axis, P=P), left

    def _bounded(self, C: Array) -> BoundedRows:
        key = C.tobytes()
        if key not in self._rows:
            self._rows[key] = BoundedRows(C, self._reach)
        return self._rows[key]

    # --- backwards --------------------------------------------------------------------------------

    def _inferred(self, run: Sequence[Transition]) -> list[InferredStep]:
        mixtures, _, moves = self._forward(run)
        last = run[-1]
        end = mixtures[-1]
        if moves[-1]:
            after = replace(last, x=last.x_next, candidates=None)
            end = self._after(end, moves[-1], after)
        drawn = self._drawn(end)
        steps: list[InferredStep] = []
        for now, t, ways in zip(mixtures[::-1], run[::-1], moves[::-1], strict=True):
            if not ways:
                steps.append(InferredStep(t, None))
                drawn = self._drawn(now)
                continue
            drawn, gauges = self._back(now, ways, drawn)
            if t.whole and not self._noise:
                gauges = self._shape.gauges(residuals_of(self._A, self._B, [t]))
            steps.append(InferredStep(t, gauges))
        return steps[::-1]

    def _drawn(self, now: Mixture) -> Array:
        """States drawn, shape (S, n)."""
        p = np.exp(now.weights - now.weights.max())
        picked = self._rng.choice(len(p), self._samples, p=p / p.sum())
        return now.means[picked] + self._normal(now.P[picked])

    def _normal(self, P: Array) -> Array:
        """Draws of covariances ``P``, shape (..., n, n)."""
        values, vectors = np.linalg.eigh(P)
        z = np.sqrt(np.maximum(values, 0.0)) * self._rng.standard_normal(values.shape)
        found: Array = np.einsum("...ij,...j->...i", vectors, z)
        return found

    def _back(self, now: Mixture, ways: Sequence[Move], after: Array) -> tuple[Array, Array]:
        """States before ``after``, shape (S, n), and the gauges of that step, shape (S, M)."""
        count = len(after)
        A = np.stack([move.A for move in ways])  # of shape (W, N, M, n, n)
        c = np.stack([move.c for move in ways])
        error = np.stack([move.error for move in ways])
        BB = self._B @ self._B.T
        noise = self._Q + (error**2)[..., None, None, None] * BB
        S = A @ now.P[:, None] @ A.swapaxes(-1, -2) + noise
        mean = np.einsum("wcink,ck->wcin", A, now.means) + c
        prior = now.weights[:, None] + np.array([move.weight for move in ways])[:, None, None]
        prior = np.broadcast_to(prior, S.shape[:3]).reshape(-1)
        S, mean = S.reshape(-1, self._n, self._n), mean.reshape(-1, self._n)
        W = np.linalg.cholesky(np.linalg.inv(S))
        prior = prior + np.log(W.diagonal(axis1=1, axis2=2)).sum(axis=1)
        near = after[:, None] - mean
        log = prior - 0.5 * (np.einsum("shi,hij->shj", near, W) ** 2).sum(axis=2)
        share = np.exp(log - log.max(axis=1, keepdims=True)).cumsum(axis=1)
        u = self._rng.random((PROPOSALS, count)) * share[:, -1]
        at = np.array([np.searchsorted(row, u[:, s]) for s, row in enumerate(share)]).T
        at = np.minimum(at, share.shape[1] - 1)
        way, part, choice = np.unravel_index(at, A.shape[:3])
        # of shape (PROPOSALS, S, ...)
        gain = (now.P[part] @ A[way, part, choice].swapaxes(-1, -2)) @ np.linalg.inv(S)[at]
        x = now.means[part] + np.einsum("psab,psb->psa", gain, after - mean[at])
        x = x + self._normal(now.P[part] - gain @ A[way, part, choice] @ now.P[part])
        d = after - np.einsum("psab,psb->psa", A[way, part, choice], x) - c[way, part, choice]
        wide = error[way, part][..., None] * np.sqrt(BB.diagonal())
        weight = self._whole.log_ratio(d, wide)
        kept = (
            (weight + self._rng.gumbel(size=weight.shape)).argmax(axis=0), np.arange(count),
        )  # fmt: skip
        x, d, way, part, choice = x[kept], d[kept], way[kept], part[kept], choice[kept]
        # of what is left, a part is how the applied input was misread
        share_of_d = self._Q @ np.linalg.inv(self._Q + (error[way, part] ** 2)[:, None, None] * BB)
        d = np.einsum("sab,sb->sa", share_of_d, d)
        predicted = np.einsum("smab,sb->sma", A[way, part], x) + c[way, part]
        apart = predicted[np.arange(count), choice][:, None] - predicted
        misread = np.stack([move.misread for move in ways])[way, part]
        if misread.any():
            blur = self._rng.standard_normal((*apart.shape[:2], self._B.shape[1])) @ self._B.T
            blur *= np.sqrt(2) * (error[way, part] * misread)[:, None, None]
            blur[np.arange(count), choice] = 0.0
            apart = apart + blur
        return x, self._shape.gauges(d[:, None] + apart)


@dataclass(frozen=True)
class Origin:
    """Where the last disturbance, which is bounded, moved a state: means and covariances."""

    means: Array
    own: Array

    @property
    def wide(self) -> Array:
        """Standard deviations, shape (N, n)."""
        return _deviations(self.own)

    def of(self, kept: Flags | Indices) -> "Origin":
        """Some of them."""
        return Origin(self.means[kept], self.own[kept])


def _updated(now: Mixture, C: Array, off: Array, variance: Array) -> Mixture:
    """The mixture after a reading that is ``off`` by C times the state's error, weighed by it."""
    if not len(C):
        return now
    CP = C @ now.P
    S = CP @ C.T + np.diag(variance)
    K = np.linalg.solve(S, CP).swapaxes(1, 2)
    P = now.P - K @ CP
    P = (P + P.swapaxes(1, 2)) / 2
    means = now.means + np.einsum("cir,cr->ci", K, off)
    return replace(now, weights=now.weights + _log_normal(off, S), means=means, P=P)


def _log_normal(off: Array, S: Array) -> Array:
    """Log densities of shape (...,)."""
    found = np.maximum(
        np.einsum("...i,...i->...", off, np.linalg.solve(S, off[..., None])[..., 0]), 0.0
    )
    result: Array = -0.5 * (found + np.linalg.slogdet(S)[1] + off.shape[-1] * np.log(2 * np.pi))
    return result


def _deviations(P: Array) -> Array:
    """Standard deviations of covariances."""
    return np.sqrt(np.maximum(P.diagonal(axis1=1, axis2=2), 0.0))


def _last(size: int) -> int:
    """How many sequences there are of the last symbols that count."""
    out = size
    while out * size <= LAG:
        out *= size
    return out
