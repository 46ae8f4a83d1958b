"""States and applied candidates from offers, for one who knows the control policy.

Every offer is a reading of the state it was made in (:mod:`tap_service.inference.policy`): exact in
one coordinate where a candidate is free or its facet is known, and a bound where it is not. What
she believes of x(k) is a cloud of particles. Each goes on by every candidate that may have been
applied and every way in which the next offer may have come about, is drawn under that reading
exactly, and is dropped where the law would have offered something else. Afterwards trajectories are
drawn backwards through the clouds (Godsill, Doucet and West 2004), so that later offers count as
well. A state that was heard is a reading of all its coordinates; an offer that was lost follows
from the state, where its facets are known.

Two scales are learned, as those that make the offers likeliest: the width of D_c, on which the
facets depend, and that of the disturbance, which is taken for even over the shape of D_e.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import Array
from tap_service.capture.transcript import Transition, steps_in_a_row
from tap_service.inference.active_sets import Explanations, Scales, Ways
from tap_service.inference.gap_smoother import InferredStep
from tap_service.inference.policy import KnownLaw

Places = NDArray[np.intp]

SAMPLES: Final = 64
"""Trajectories drawn."""

PARTICLES: Final = 300
"""Particles kept from step to step."""

FEW: Final = 120
"""The same while scales are tried."""

DRAWS: Final = 2
"""Draws for each particle kept, of which those that contradict the law are dropped."""

LOST: Final = -12.0
"""Log evidence of an offer below which she takes the state for lost, and begins anew."""

UNEXPLAINED: Final = -8.0
"""Log evidence of an offer that noise hides so far that the law cannot have made it."""

ANYWHERE: Final = tuple(np.geomspace(0.03, 10.0, 6).tolist())
"""Standard deviations of a state of which nothing is known, in half-widths of D_e."""

WIDTHS: Final = tuple(np.geomspace(1.0, 1 / 64, 7).tolist())
"""Widths of D_c over D_e that are tried first; then between the best and its neighbours."""

FINER: Final = ((1.12, 0.06), (1.04, 0.02), (1.015, 0.01))
"""Ratios of the widths that are then tried about the best, and the doubt with which."""

AROUND: Final = range(-3, 6)
"""How many of these ratios away: much doubt favours widths that are too small."""

CLIMBS: Final = 3
"""Steps by which the disturbance's scale is then moved at most, each of the ratio's square."""

TRIAL: Final = 160
"""Steps on which scales are tried."""

EXPLAINED: Final = 0.05
"""Share of the inputs' spread that a law may leave of most offers, noise apart."""

EXACTLY: Final = 1e-3
"""Doubt about the width where it was read off states and offers heard together."""

BLURRED: Final = 2.0
"""Ratio up to which noise may lead her astray about the width."""

BULK: Final = 0.9
"""Share of the steps heard whole by whose disturbances its size is measured."""

LEAST: Final = 32
"""Offers in a row from which she begins to infer."""

TINY: Final = 1e-9
LOG_2PI: Final = float(np.log(2 * np.pi))

FLAT: Final = 8
"""Power of the gauge in the density of d: even inside, falling steeply outside."""

OUTLIER: Final = -10.0
"""Log of the least density of d, over that at zero."""


class OffersReader:
    """Infers what was applied from offers and the states heard beside them, with the law known.

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
        self._learned = 0

    @property
    def support(self) -> float:
        """Gauge of the largest disturbance, as she takes it."""
        return 1.0 if self._scales is None else self._scales.size

    @property
    def width(self) -> tuple[float, float] | None:
        """D_c over D_e, from and to, where the facets tell it."""
        if self._scales is None or not self._law.facets:
            return None
        room = BLURRED if self._noise else 1 + 3 * self._scales.doubt
        return self._scales.width / room, self._scales.width * room

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
        centres, shares, Q, plain = self._onward(x, before)
        drawn, w, centre = self._draws(centres, shares - np.log(len(x)), Q, t)
        if plain:
            d = drawn - centre
            normal = 0.5 * ((d * d) @ (1 / np.diag(Q))) + 0.5 * float(np.log(np.diag(Q)).sum())
            w = w + self._density(d, self._scales.size) + normal
        if not w.max() > LOST:
            return self._begin(t)[0], LOST
        places, total = self._picked(w, self._count)
        return drawn[places], total - float(np.log(len(w)))

    def _draws(
        self, centres: Array, w: Array, Q: Array, t: Transition
    ) -> tuple[Array, Array, Array]:
        """States after what was heard of an offer: draws, log weights, and whence they came.

        ``centres``, shape (R, n), of log weights ``w``, stand for Gaussians of covariance ``Q``.
        The mean of the weights is the evidence.
        """
        assert self._scales is not None
        count = DRAWS * self._count
        items = []
        if t.candidates is not None:
            items = self._ways.items(self._law.solved(np.array(t.candidates)))
        state = None if t.x is None else np.array(t.x)
        heard = bool(items) or state is not None
        ways = self._ways.ways(items, state, centres, Q, self._scales) if heard else []
        if not ways:  # nothing was heard, or what no way explains
            picked, total = self._picked(w, count)
            z = self._rng.standard_normal((count, self._n)) @ _factor(Q).T
            total += UNEXPLAINED if heard else 0.0
            return centres[picked] + z, np.full(count, total), centres[picked]
        groups = [self._weighed(way, centres, w, Q) for way in ways]
        table = np.concatenate([g.ravel() for g, *_ in groups])
        flat, total = self._picked(table, count)
        parts, first = [], 0
        for way, (g, K, factor, e) in zip(ways, groups, strict=True):
            mine = flat[(flat >= first) & (flat < first + g.size)] - first
            first += g.size
            centre, j = np.unravel_index(mine, g.shape)
            mean = centres[centre] + np.einsum("pnr,pr->pn", K[j], e[centre, j])
            z = self._rng.standard_normal(mean.shape)
            x = mean + np.einsum("pnm,pm->pn", factor[j], z)
            ok = self._ways.allowed(x, items, way, self._scales)
            parts.append((x, np.where(ok, total, -np.inf), centres[centre]))
        x, v, source = (np.concatenate(column) for column in zip(*parts, strict=True))
        return x, v, source

    def _weighed(
        self, way: Ways, centres: Array, w: Array, Q: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Log weights of centres and ways, shape (R, H); gains, spreads and whitened residuals."""
        rows = way.y.shape[1]
        CQ = way.C @ Q
        S = CQ @ way.C.swapaxes(1, 2) + way.r[:, :, None] * np.eye(rows)
        white = np.linalg.inv(np.linalg.cholesky(S))  # of S; its rows make the readings independent
        y = (white @ way.y[:, :, None])[:, :, 0]
        C = (white @ way.C).reshape(-1, self._n)
        e = y - (centres @ C.T).reshape(len(centres), *y.shape)
        scale = np.log(white.diagonal(axis1=1, axis2=2)).sum(axis=1) - 0.5 * rows * LOG_2PI
        table = w[:, None] + (way.prior + scale)
        for q in range(rows):
            table -= 0.5 * np.square(e[:, :, q])
        K = (white @ CQ).swapaxes(1, 2)
        return table, K, _factor(Q - K @ K.swapaxes(1, 2)), e

    def _picked(self, w: Array, count: int) -> tuple[Places, float]:
        """Places drawn by log weights, as evenly as can be, in order; the log of their sum."""
        top = float(w.max())
        share = np.exp(w - top).cumsum()
        at = (np.arange(count) + self._rng.random()) * (share[-1] / count)
        places = np.minimum(np.searchsorted(share, at), len(w) - 1)
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
        centres, shares, Q, _ = self._onward(clouds[-1], transitions[-1])
        picked, _ = self._picked(shares, SAMPLES)
        z = self._rng.standard_normal((SAMPLES, self._n)) @ _factor(Q).T
        states[:, -1] = self._rng.permutation(centres[picked] + z)
        if transitions[-1].x_next is not None:
            z = self._rng.standard_normal((SAMPLES, self._n))
            states[:, -1] = np.array(transitions[-1].x_next) + self._noise * z
        for i in range(len(transitions) - 1, -1, -1):
            centres, shares, Q, plain = self._onward(clouds[i], transitions[i])
            d = states[:, i + 1, None] - centres
            if plain:
                w = shares + self._density(d, self._scales.size)
            else:
                w = -0.5 * np.einsum("scn,nm,scm->sc", d, np.linalg.inv(Q), d)
            share = np.exp(w - w.max(axis=1, keepdims=True)).cumsum(axis=1)
            at = self._rng.random((SAMPLES, 1)) * share[:, -1:]
            chosen = (share < at).sum(axis=1) // (len(centres) // len(clouds[i]))
            states[:, i] = clouds[i][chosen]
        return states

    # --- what she makes of it ---------------------------------------------------------------------

    def _evidence(self, transitions: Sequence[Transition], scales: Scales) -> float:
        kept, self._scales = self._scales, scales
        evidence = self._forward(transitions)[1]
        self._scales = kept
        return evidence

    def _learn(self, transitions: Sequence[Transition]) -> None:
        """The scales that make the offers likeliest."""
        trial = transitions[:TRIAL]
        if len(trial) <= self._learned:
            return
        self._learned, self._count = len(trial), FEW

        def likeliest(tried: Iterable[Scales]) -> Scales:
            return max(tried, key=lambda scales: self._evidence(trial, scales))

        best = self._scales or likeliest(Scales(w, 0.8 * w, 0.4) for w in WIDTHS)
        for ratio, doubt in FINER if self._scales is None else FINER[1:]:
            best = replace(best, doubt=doubt)
            if self._law.facets:
                widths = {min(best.width * ratio**j, 1.0) for j in AROUND}
                best = likeliest(replace(best, width=width) for width in sorted(widths))
            for _ in range(CLIMBS):
                sizes = (best.size / ratio**2, best.size, min(best.size * ratio**2, 1.0))
                now = best
                best = likeliest(replace(best, size=size) for size in sizes)
                if best == now:
                    break
        self._scales, self._count = best, PARTICLES

    def infer(self, transitions: Sequence[Transition]) -> list[InferredStep]:
        """Infer transitions, the whole transcript that is kept; what stays open has no samples."""
        runs = [_joined(run) for run in steps_in_a_row(transitions)]
        longest = max(runs, key=len, default=[])
        offers = [np.array(t.candidates) for t in longest if t.candidates is not None]
        if len(offers) < LEAST:
            return [InferredStep(t, None) for t in transitions]
        solved = np.concatenate([self._law.solved(offer) for offer in offers])
        self._ways.spread = max(float(solved.std()), TINY)
        if not self._measured(transitions):
            self._learn(longest)
        return [step for run in runs for step in self._inferred(run)]

    def trusts(self, transitions: Sequence[Transition]) -> bool:
        """Whether the law explains the offers that were heard with their states, if any."""
        pairs = _pairs(transitions)
        if pairs is None:
            return True
        _, off = self._width_of(*pairs)
        slopes = np.concatenate([np.linalg.norm(f.slopes, axis=1) for f in self._law.facets])
        return off <= EXPLAINED * float(pairs[1].std()) + 2 * self._noise * float(np.median(slopes))

    def _width_of(self, x: Array, u: Array) -> tuple[float, float]:
        """The width under which the law explains offers best, and what it leaves."""

        def off(width: float) -> float:
            return float(np.median(np.abs(self._law.offers(x, width) - u).max(axis=(1, 2))))

        width, ratio = 1 / 8, 8.0
        while ratio > 1 + EXACTLY / 4:
            widths = width * np.geomspace(1 / ratio, ratio, 81)
            width = min(float(min(widths.tolist(), key=off)), 1.0)
            ratio = ratio ** (1 / 20)
        return width, off(width)

    def _measured(self, transitions: Sequence[Transition]) -> bool:
        """The scales from states and offers that were heard exactly, if there are enough."""
        pairs = _pairs(transitions)
        whole = [t for t in transitions if t.whole]
        if self._noise or not self._law.facets or pairs is None or len(whole) < LEAST:
            return False
        width, _ = self._width_of(*pairs)
        x, x_next = np.array([t.x for t in whole]), np.array([t.x_next for t in whole])
        u = np.array([t.candidates for t in whole])
        residual = (x_next - x @ self._A.T)[:, None] - u @ self._B.T
        gauge = (residual @ self._shape.T).max(axis=2).min(axis=1)
        size = min(float(np.quantile(gauge, BULK)) / BULK ** (1 / self._n), 1.0)
        self._scales = Scales(width, size, EXACTLY)
        return True

    def _inferred(self, run: Sequence[Transition]) -> list[InferredStep]:
        states = self._backward(run, self._forward(run)[0])
        steps = []
        for i, t in enumerate(run):
            u = self._offers(states[:, i], t)
            if u is None:
                steps.append(InferredStep(t, None))
                continue
            residual = states[:, i + 1] - states[:, i] @ self._A.T
            residual = residual[:, None] - u @ self._B.T
            if t.whole and not self._noise:
                residual = residual[:1]
            steps.append(InferredStep(t, np.maximum((residual @ self._shape.T).max(axis=2), 0.0)))
        return steps


def _pairs(transitions: Sequence[Transition]) -> tuple[Array, Array] | None:
    """States and the offers made in them where both were heard, if they are enough."""
    pairs = [(t.x, t.candidates) for t in transitions if t.x and t.candidates]
    if len(pairs) < LEAST:
        return None
    return np.array([x for x, _ in pairs]), np.array([u for _, u in pairs])


def _joined(run: list[Transition]) -> list[Transition]:
    """A state that was heard after one step is the state before the next."""
    return run[:1] + [
        t if t.x is not None or before.x_next is None else replace(t, x=before.x_next)
        for before, t in pairwise(run)
    ]


def _factor(Q: Array) -> Array:
    """A square root of one covariance or of several."""
    values, vectors = np.linalg.eigh((Q + Q.swapaxes(-1, -2)) / 2)
    out: Array = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
    return out
