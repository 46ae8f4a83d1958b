"""The control law as one affine function of the state for each candidate: what holds mostly.

By the policy's costs where no constraint is active, or by the offers whose state was heard, if
these say something else.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from protocol.arrays import Array, Flags, Indices
from tap_service.capture.transcript import Transition
from tap_service.inference.policy import KnownLaw

ENOUGH: Final = 16
"""Pairs of a state and its offer from which a law is fitted."""

ROUNDS: Final = 30
"""Of a fit that lets strays go."""

NEAR: Final = 4
"""Neighbours by which the law is corrected."""

BLURRED: Final = 3.0
"""Deviations of what noise leaves, up to which neighbours correct nothing."""

ASTRAY: Final = 0.03
"""Share of the offers that are as their neighbours, and of those that are anything."""

ANYTHING: Final = 8.0
"""Deviation of an offer that is anything, over the spread of the offers."""

BENT: Final = 1e-4
"""Over the spread of the offers: from here on a law that is exact is bent."""

MOSTLY: Final = 0.75
"""Share of the pairs by which a law is judged."""

LEAST: Final = 1e-7
"""Error of a law that is exact, over the spread of the offers."""


@dataclass(frozen=True)
class Item:
    """A part of an offer, and the ways in which it may have come about: C x = y in each.

    Parameters
    ----------
    C : array, shape (ways, r, n)
    y : array, shape (ways, r)
    variance : float
        Of each reading.
    holds : callable, optional
        Whether the law answers so: of states of shape (N, places, n), a way for each N, the flags.
    """

    C: Array
    y: Array
    variance: float
    holds: Callable[[Array, Indices], Flags] | None = None


@dataclass(frozen=True)
class Form:
    """What is offered about states: u_i = G_i x + g_i, but for an error.

    Parameters
    ----------
    weight : float
        Log probability that it is.
    G : array, shape (N or 1, M, m, n)
    g : array, shape (N or 1, M, m)
    error : float
        Standard deviation.
    """

    weight: float
    G: Array
    g: Array
    error: float


@dataclass(frozen=True)
class AffineLaw:
    """u_i = G_i x + g_i, but for an error.

    Parameters
    ----------
    G : array, shape (M, m, n)
    g : array, shape (M, m)
    error : float
        Standard deviation of what it leaves.
    spread : float
        Of the offers.
    shared : bool
        Whether the candidates stand about one input.
    """

    G: Array
    g: Array
    error: float
    spread: float
    shared: bool
    blur: float = 0.0
    pairs: "Pairs | None" = None

    @classmethod
    def of(
        cls, known: KnownLaw | None, transitions: Sequence[Transition], noise: float
    ) -> "AffineLaw | None":
        """The law by what is known of it and what was heard; None where that is nothing."""
        offers = [t for t in transitions if t.candidates is not None]
        if not offers:
            return None
        u = np.array([t.candidates for t in offers])
        shared = known is not None and known.shared
        offsets = (u - u.mean(axis=1, keepdims=True)).mean(axis=0)
        spread = max(float(u.mean(axis=1).std()) if shared else float(u.std()), 1e-9)
        paired = np.array([t.x is not None for t in offers])
        x = np.array([t.x for t in offers if t.x is not None])
        answers = u[paired]
        tried: list[tuple[float, Array, Array]] = []

        def judged(G: Array, g: Array) -> None:
            left = answers - np.einsum("imn,sn->sim", G, x) - g
            off = np.sqrt((left**2).mean(axis=(1, 2)))
            tried.append((float(np.quantile(off, MOSTLY)), G, g))

        if known is not None:
            G = np.repeat(known.free, len(u[0]), axis=0) if shared else known.free
            g = offsets if shared else np.zeros(u.shape[1:])
            if len(x) < ENOUGH:
                return cls(G, g, LEAST * spread, spread, shared)
            judged(G, g)
        if len(x) >= ENOUGH:
            judged(*_fitted(x, answers, shared=shared))
        if not tried:
            return None
        left, G, g = tried[0]
        if len(tried) > 1 and tried[1][0] < 0.8 * left:
            left, G, g = tried[1]
        blur = noise * np.sqrt((G**2).sum(axis=2).mean() + 1)
        error = np.sqrt(max(left**2 - (1.2 * blur) ** 2, 0.0))
        law = cls(G, g, max(float(error), LEAST * spread), spread, shared, float(blur))
        return replace(law, pairs=Pairs.of(law, x, answers)) if len(x) >= ENOUGH else law

    def forms(self, x: Array) -> list[Form]:
        """What an offer about states ``x``, shape (N, n), may be.

        As the law is as a whole, as offers were whose state was next to it, or anything.
        """
        G = self.G[None]
        out = [Form(float(np.log(1 - 2 * ASTRAY)), G, self.g[None], self.error)]
        if self.pairs is not None:
            left, error = self.pairs.near(x[0])
            if np.abs(left).max() > BLURRED * self.blur + BENT * self.spread:
                error = float(np.sqrt(max(error**2 - self.blur**2, 0.0)))
                near = max(error, self.error)
                out.append(Form(float(np.log(ASTRAY)), G, (self.g + left)[None], near))
        out.append(Form(float(np.log(ASTRAY)), G, self.g[None], ANYTHING * self.spread))
        return out

    def averaged(self, u: Array) -> Array:
        """An offer whose candidates share one input, each misread by itself, with that of all."""
        return (u - self.g).mean(axis=0) + self.g

    def items(self, offer: Array, noise: float) -> list[Item]:
        """What an offer says of its state: all candidates together where they share one input."""
        apart = offer - self.g
        if self.shared:
            variance = noise**2 / len(offer) + self.error**2
            return [Item(self.G[:1], apart.mean(axis=0)[None], variance)]
        told = np.abs(self.G).sum(axis=2) > 0
        return [
            Item(G[None, rows], y[None, rows], noise**2 + self.error**2)
            for G, y, rows in zip(self.G, apart, told, strict=True)
            if rows.any()
        ]


class Pairs:
    """What the law left of offers, by their states."""

    def __init__(self, x: Array, left: Array) -> None:
        from scipy.spatial import cKDTree

        self._unit = np.maximum(x.std(axis=0), 1e-12)
        self._tree, self._left = cKDTree(x / self._unit), left

    @classmethod
    def of(cls, law: AffineLaw, x: Array, u: Array) -> "Pairs":
        """The pairs of a law."""
        return cls(x, u - np.einsum("imn,sn->sim", law.G, x) - law.g)

    def near(self, x: Array) -> tuple[Array, float]:
        """What the nearest say, and how far they differ."""
        found, at = (np.asarray(one) for one in self._tree.query(x / self._unit, NEAR))
        weight = 1 / (found + 0.3 * found[-1] + 1e-12)
        weight /= weight.sum()
        left = self._left[at]
        mean = np.einsum("s,sim->im", weight, left)
        error = np.sqrt(np.einsum("s,sim->im", weight, (left - mean) ** 2).mean())
        return mean, float(error)


def _fitted(x: Array, u: Array, *, shared: bool) -> tuple[Array, Array]:
    """Affine functions that leave most pairs the least."""
    phi = np.hstack([x, np.ones((len(x), 1))])
    target = u.mean(axis=1) if shared else u.reshape(len(u), -1)
    weight = np.ones(len(x))
    for _ in range(ROUNDS):
        root = np.sqrt(weight)[:, None]
        theta = np.linalg.lstsq(root * phi, root * target, rcond=None)[0]
        off = np.abs(target - phi @ theta).max(axis=1)
        weight = 1 / (off + 1e-6 * off.mean() + 1e-12)
    size, m = u.shape[1:]
    if not shared:
        G = theta[:-1].T.reshape(size, m, -1)
        return G, theta[-1].reshape(size, m)
    offsets = (u - u.mean(axis=1, keepdims=True)).mean(axis=0)
    return np.repeat(theta[:-1].T[None], size, axis=0), theta[-1] + offsets
