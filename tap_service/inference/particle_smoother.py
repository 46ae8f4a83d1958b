"""Trajectories of the state from offers: a particle smoother that knows the control law.

Every offer is a reading of the state it was made in (:mod:`tap_service.inference.policy`): exact in
one coordinate where a candidate is free or its facet is known, and a bound where it is not. What
she believes of x(k) is a cloud of particles. Each goes on by every candidate that may have been
applied and every way in which the next offer may have come about, is drawn under that reading
exactly, and is dropped where the law would have offered something else. Afterwards trajectories are
drawn backwards through the clouds (Godsill, Doucet and West 2004), so that later offers count as
well. A state that was heard is a reading of all its coordinates; an offer that was lost follows
from the state, where its facets are known.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import Array
from tap_service.capture.transcript import Transition
from tap_service.inference.active_sets import Explanations, Scales, Ways
from tap_service.inference.policy import KnownLaw

Places = NDArray[np.intp]

SAMPLES: Final = 64
"""Trajectories drawn."""

PARTICLES: Final = 300
"""Particles kept from step to step."""

DRAWS: Final = 2
"""Draws for each particle kept, of which those that contradict the law are dropped."""

LOST: Final = -12.0
"""Log evidence of an offer below which she takes the state for lost, and begins anew."""

UNEXPLAINED: Final = -8.0
"""Log evidence of an offer that noise hides so far that the law cannot have made it."""

ANYWHERE: Final = tuple(np.geomspace(0.03, 10.0, 6).tolist())
"""Standard deviations of a state of which nothing is known, in half-widths of D_e."""

LOG_2PI: Final = float(np.log(2 * np.pi))

NEGLIGIBLE: Final = 50.0
"""Log weight below the largest from which on nothing is ever drawn."""

FLAT: Final = 8
"""Power of the gauge in the density of d: even inside, falling steeply outside."""

OUTLIER: Final = -10.0
"""Log of the least density of d, over that at zero."""


class ParticleSmoother:
    """Trajectories from offers and the states heard beside them, the law and the scales given.

    Parameters
    ----------
    A, B : array
        Her model.
    shape : array, shape (rows, n)
        H / h of D_e: the gauge of v is the largest entry of ``shape @ v``.
    law : KnownLaw
    noise : float
        Standard deviation of what she reads.
    """

    def __init__(self, A: Array, B: Array, shape: Array, law: KnownLaw, noise: float) -> None:
        self._A, self._B, self._shape, self._law = A, B, shape, law
        self._noise = noise
        self._ways = Explanations(law, noise)
        self._n = len(A)
        self._edge = 1.0 / np.abs(shape).max(axis=0)
        self._rng = np.random.default_rng(0)
        self._count = PARTICLES
        self._scales: Scales | None = None

    # --- one step ---------------------------------------------------------------------------------

    def _density(self, d: Array, size: float) -> Array:
        """Log density of disturbances, shape (..., n), but for a constant: even, then steep."""
        gauge = np.maximum((d @ self._shape.T).max(axis=-1), 0.0) / size
        out: Array = np.logaddexp(-(gauge**FLAT), OUTLIER - 0.5 * gauge) - self._n * np.log(size)
        return out

    def _offers(self, x: Array, t: Transition) -> Array | None:
        """What was offered in states ``x``, shape (N, n), heard or not; shape (N, M, m).

        None where it was not heard and the facets do not tell it.
        """
        assert self._scales is not None
        if t.candidates is not None:
            return np.tile(np.array(t.candidates), (len(x), 1, 1))
        width = self._scales.width
        if not self._law.facets or self._law.holds(x, width).mean() < 0.5:
            return None
        return self._law.offers(x, width)

    def _onward(self, x: Array, t: Transition) -> tuple[Array, Array, Array, bool]:
        """Where states go: centres, shape (N * inputs, n), log shares, and what blurs them.

        Last, whether that is the disturbance alone.
        """
        assert self._scales is not None
        Q = np.diag((self._scales.size * self._edge) ** 2 / 3)
        moved = x @ self._A.T
        if t.candidates is None:
            u = self._offers(x, t)
            if u is None:  # any input, as often as they were
                blur = self._ways.spread**2 * self._B @ self._B.T
                return moved, np.zeros(len(x)), Q + blur, False
            shares = np.zeros(u.shape[1]) - np.log(u.shape[1])
            return self._towards(moved, u), np.tile(shares, len(x)), Q, True
        items = self._ways.items(np.array(t.candidates))
        shares = np.log([len(item.costs) / len(t.candidates) for item in items])
        u = np.array([item.u for item in items])[None]
        return self._towards(moved, u), np.tile(shares, len(x)), Q, True

    def _towards(self, moved: Array, u: Array) -> Array:
        """Centres of ``moved``, shape (N, n), under inputs of shape (N or 1, inputs, m)."""
        out: Array = (moved[:, None] + u @ self._B.T).reshape(-1, self._n)
        return out

    def _begin(self, t: Transition) -> tuple[Array, float]:
        """The cloud after an offer in a state of which nothing was known; its log evidence."""
        parts = []
        for scale in ANYWHERE:
            Q = np.diag((scale * self._edge) ** 2)
            x, w, _ = self._draws(np.zeros((1, self._n)), np.zeros(1), Q, t)
            parts.append((x, w))
        w = np.concatenate([w for _, w in parts])
        x = np.concatenate([x for x, _ in parts])
        if not np.isfinite(w.max()):
            w = np.full(len(w), LOST)
        places, total = self._picked(w, self._count)
        return x[places], total - float(np.log(len(w)))

    def _step(self, x: Array, before: Transition, t: Transition) -> tuple[Array, float]:
        """The cloud one step on, after the next offer; that offer's log evidence."""
        assert self._scales is not None
        predictions, shares, Q, plain = self._onward(x, before)
        drawn, w, centre = self._draws(predictions, shares - np.log(len(x)), Q, t)
        if plain:
            d = drawn - centre
            normal = 0.5 * ((d * d) @ (1 / np.diag(Q))) + 0.5 * float(np.log(np.diag(Q)).sum())
            w = w + self._density(d, self._scales.size) + normal
        if not w.max() > LOST:
            return self._begin(t)[0], LOST
        places, total = self._picked(w, self._count)
        return drawn[places], total - float(np.log(len(w)))

    def _draws(
        self, predictions: Array, w: Array, Q: Array, t: Transition
    ) -> tuple[Array, Array, Array]:
        """States after what was heard of an offer: draws, log weights, and whence they came.

        ``predictions``, shape (R, n), of log weights ``w``, stand for Gaussians of covariance
        ``Q``. The mean of the weights is the evidence.
        """
        assert self._scales is not None
        count = DRAWS * self._count
        items = []
        if t.candidates is not None:
            items = self._ways.items(self._law.solved(np.array(t.candidates)))
        state = None if t.x is None else np.array(t.x)
        heard = bool(items) or state is not None
        ways = self._ways.ways(items, state, predictions, Q, self._scales) if heard else []
        if not ways:  # nothing was heard, or what no way explains
            picked, total = self._picked(w, count)
            z = self._rng.standard_normal((count, self._n)) @ _factor(Q).T
            total += UNEXPLAINED if heard else 0.0
            return predictions[picked] + z, np.full(count, total), predictions[picked]
        groups = [self._weighed(way, predictions, w, Q) for way in ways]
        table = np.concatenate([g.ravel() for g, *_ in groups])
        flat, total = self._picked(table, count)
        ends = np.cumsum([g.size for g, *_ in groups])
        parts, begin = [], 0
        for way, (g, K, e), last in zip(ways, groups, ends, strict=True):
            end = int(flat.searchsorted(last))  # they are in order
            mine, begin = flat[begin:end] - (last - g.size), end
            if not len(mine):
                continue
            centre, j = np.unravel_index(mine, g.shape)
            mean = predictions[centre] + np.einsum("pnr,rp->pn", K[j], e[:, centre, j])
            z = self._rng.standard_normal(mean.shape)
            drawn, which = np.unique(j, return_inverse=True)
            factor = _factor(Q - K[drawn] @ K[drawn].swapaxes(1, 2))
            x = mean + np.einsum("pnm,pm->pn", factor[which], z)
            ok = self._ways.allowed(x, items, way, self._scales)
            parts.append((x, np.where(ok, total, -np.inf), predictions[centre]))
        x, v, source = (np.concatenate(column) for column in zip(*parts, strict=True))
        return x, v, source

    def _weighed(
        self, way: Ways, predictions: Array, w: Array, Q: Array
    ) -> tuple[Array, Array, Array]:
        """Log weights of centres and ways, shape (R, H), and of each way its gain.

        Last the whitened residuals, shape (rows, R, H).
        """
        rows = way.y.shape[1]
        if not rows:  # nothing is read
            nothing = np.empty((0, len(predictions), 1))
            return w[:, None] + way.prior, np.empty((1, self._n, 0)), nothing
        CQ = way.C @ Q
        S = CQ @ way.C.swapaxes(1, 2) + way.r[:, :, None] * np.eye(rows)
        # of S; its rows make the readings independent
        white = 1 / np.sqrt(S) if rows == 1 else np.linalg.inv(np.linalg.cholesky(S))
        y = (white @ way.y[:, :, None])[:, :, 0]
        C = white @ way.C
        scale = np.log(white.diagonal(axis1=1, axis2=2)).sum(axis=1) - 0.5 * rows * LOG_2PI
        table = w[:, None] + (way.prior + scale)
        e = np.empty((rows, len(predictions), len(y)))  # a row at a time: it lies in one piece
        for q in range(rows):
            np.subtract(y[:, q], predictions @ C[:, q].T, out=e[q])
            table -= 0.5 * np.square(e[q])
        return table, (white @ CQ).swapaxes(1, 2), e

    def _picked(self, w: Array, count: int) -> tuple[Places, float]:
        """Places drawn by log weights, as evenly as can be, in order; the log of their sum."""
        top = float(w.max())
        (likely,) = (w > top - NEGLIGIBLE).nonzero()
        share = np.exp(w[likely] - top).cumsum()
        at = (np.arange(count) + self._rng.random()) * (share[-1] / count)
        places = likely[np.minimum(np.searchsorted(share, at), len(likely) - 1)]
        return places, top + float(np.log(share[-1]))

    # --- forwards and backwards -------------------------------------------------------------------

    def _forward(self, transitions: Sequence[Transition]) -> tuple[list[Array], float]:
        """The cloud of each x(k) by what came before, and the log evidence of it all."""
        cloud, evidence = self._begin(transitions[0])
        clouds = [cloud]
        for before, t in pairwise(transitions):
            cloud, gain = self._step(cloud, before, t)
            clouds.append(cloud)
            evidence += gain
        return clouds, evidence

    def _backward(self, transitions: Sequence[Transition], clouds: Sequence[Array]) -> Array:
        """Trajectories by what came after too, shape (S, T + 1, n)."""
        assert self._scales is not None
        states = np.empty((SAMPLES, len(transitions) + 1, self._n))
        predictions, shares, Q, _ = self._onward(clouds[-1], transitions[-1])
        picked, _ = self._picked(shares, SAMPLES)
        z = self._rng.standard_normal((SAMPLES, self._n)) @ _factor(Q).T
        states[:, -1] = self._rng.permutation(predictions[picked] + z)
        if transitions[-1].x_next is not None:
            z = self._rng.standard_normal((SAMPLES, self._n))
            states[:, -1] = np.array(transitions[-1].x_next) + self._noise * z
        for i in range(len(transitions) - 1, -1, -1):
            predictions, shares, Q, plain = self._onward(clouds[i], transitions[i])
            d = states[:, i + 1, None] - predictions
            if plain:
                w = shares + self._density(d, self._scales.size)
            else:
                w = -0.5 * np.einsum("scn,nm,scm->sc", d, np.linalg.inv(Q), d)
            share = np.exp(w - w.max(axis=1, keepdims=True)).cumsum(axis=1)
            at = self._rng.random((SAMPLES, 1)) * share[:, -1:]
            chosen = (share < at).sum(axis=1) // (len(predictions) // len(clouds[i]))
            states[:, i] = clouds[i][chosen]
        return states

    def _evidence(self, transitions: Sequence[Transition], scales: Scales) -> float:
        kept, self._scales = self._scales, scales
        evidence = self._forward(transitions)[1]
        self._scales = kept
        return evidence


def _factor(Q: Array) -> Array:
    """A square root of one covariance or of several."""
    values, vectors = np.linalg.eigh((Q + Q.swapaxes(-1, -2)) / 2)
    out: Array = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
    return out
