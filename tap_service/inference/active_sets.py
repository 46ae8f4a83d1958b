"""How an offer may have come about: what a known law leaves open, one way after the other.

A candidate is free, and then a linear reading of the state; or constrained, and then it lies on a
facet, or on one that she cannot tell. Each way of explaining a whole offer is a set of readings
that hold exactly, and inequalities: a constrained candidate would go further if it could, and no
candidate lies beyond a facet.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from protocol.arrays import Array, Flags
from tap_service.inference.policy import KnownLaw

SAME: Final = 1e-9
"""Candidates nearer than this, over their spread, coincide."""

EXACT: Final = 1e-6
"""Standard deviation given to a reading, over the spread, so that its algebra stays regular."""

SLACK: Final = 2e-3
"""Over the spread of the inputs, by how much an inequality may be missed."""

STRAY: Final = 0.01
"""Probability that a state is outside the terminal set, where other facets hold."""

POINTS: Final = 60
"""Places about a state that was heard with noise in which facets are looked for."""

ABOUT: Final = 1.5
"""Standard deviations of the noise by which they lie about it."""

MOST_SETS: Final = 64
"""Combinations of free and constrained items that are looked at."""

REACH: Final = 4.5
"""Standard deviations beyond which a facet is not looked at."""


@dataclass(frozen=True, slots=True)
class Item:
    """One value of an offer and the costs that gave it."""

    u: Array
    costs: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Ways:
    """Ways in which an offer, or one item of it, may have come about, of as many readings each.

    Parameters
    ----------
    C, y, r : arrays, shapes (H, rows, n), (H, rows) and (H, rows)
        Readings C x = y of variance r.
    prior : float
        Log prior, and the log density of values that are not explained.
    inside : bool
        Whether the state is in the terminal set, so that its facets hold.
    bound : tuple of int
        Whether each item is constrained: 0 no; for one input 1 from above, -1 from below.
    """

    C: Array
    y: Array
    r: Array
    prior: float
    inside: bool
    bound: tuple[int, ...] = ()

    def times(self, other: "Ways") -> "Ways":
        """Each of these ways together with each of the other's, for the next item."""
        here, there = np.divmod(np.arange(len(self.C) * len(other.C)), len(other.C))
        return Ways(
            np.concatenate([self.C[here], other.C[there]], axis=1),
            np.concatenate([self.y[here], other.y[there]], axis=1),
            np.concatenate([self.r[here], other.r[there]], axis=1),
            self.prior + other.prior,
            self.inside,
            (*self.bound, *other.bound),
        )


@dataclass(frozen=True, slots=True)
class Scales:
    """What she learns of the disturbance.

    Parameters
    ----------
    width : float
        D_c over D_e.
    size : float
        The set that d is spread over, over D_e.
    doubt : float
        Relative standard deviation of ``width``.
    """

    width: float
    size: float
    doubt: float


class Explanations:
    """The ways of offers.

    Parameters
    ----------
    law : KnownLaw
    noise : float
        Standard deviation of what she reads.

    Attributes
    ----------
    spread : float
        Standard deviation of the inputs, the unit of every tolerance.
    """

    def __init__(self, law: KnownLaw, noise: float) -> None:
        self._law, self._noise = law, noise
        self._m, self._n = law.free.shape[1:]
        self.spread = 1.0
        draws = np.random.default_rng(0).standard_normal((POINTS, self._n))
        self._about = ABOUT * noise * np.vstack([np.zeros((1, self._n)), draws])

    def items(self, offer: Array) -> list[Item]:
        """The distinct values, for one input from the smallest to the largest."""
        items: list[Item] = []
        for i, u in enumerate(offer):
            for j, item in enumerate(items):
                if np.abs(item.u - u).max() <= self._tolerance:
                    items[j] = Item(item.u, (*item.costs, i))
                    break
            else:
                items.append(Item(u, (i,)))
        if self._m == 1:
            items.sort(key=lambda item: float(item.u[0]))
        return items

    @property
    def _tolerance(self) -> float:
        return SAME * self.spread + 4 * self._noise

    def ways(
        self,
        items: Sequence[Item],
        state: Array | None,
        predictions: Array,
        Q: Array,
        scales: Scales,
    ) -> list[Ways]:
        """All ways of an offer, or of a state heard, that ``predictions`` do not rule out."""
        out: list[Ways] = []
        C, y = np.empty((1, 0, self._n)), np.empty((1, 0))
        if state is not None:
            C, y = np.eye(self._n)[None], state[None]
            predictions, Q = state[None], self._noise**2 * np.eye(self._n)
        r = np.full(y.shape, self._noise**2 + (EXACT * self.spread) ** 2)
        belief = predictions, Q, scales, state is not None
        for inside in (True, False) if self._law.facets else (False,):
            chance = (1 - STRAY if inside else STRAY) if self._law.facets else 1.0
            ways = [Ways(C, y, r, float(np.log(chance)), inside)]
            for place in range(len(items)):
                options = self._options(items, place, inside, belief)
                ways = [way.times(option) for way in ways for option in options][:MOST_SETS]
            out += ways
        return out

    def _options(
        self,
        items: Sequence[Item],
        place: int,
        inside: bool,
        belief: tuple[Array, Array, Scales, bool],
    ) -> list[Ways]:
        """The ways of one item."""
        predictions, Q, scales, heard = belief
        item = items[place]
        idle = bool(np.abs(item.u).max() <= self._tolerance)
        exact = self._noise**2 + (EXACT * self.spread) ** 2
        reads = [i for i in item.costs if self._law.free[i].any()]

        def linear(rows: Array, prior: float, bound: int) -> Ways:
            count = len(rows)
            y = item.u[None, :count]
            return Ways(rows[None], y, np.full((1, count), exact), prior, inside, (bound,))

        out = []
        alone = len(item.costs) == 1 or bool(self._noise)  # noise makes what differs coincide
        if idle or (alone and reads):
            rows = self._law.free[reads[0]] if reads else np.empty((0, self._n))
            out.append(linear(rows, 0.0, 0))
        if len(items) == 1 and self._law.together is not None:
            out.append(linear(self._law.together, 0.0, 0))
        z = item.u / self.spread
        unexplained = float((-0.5 * z * z - np.log(np.sqrt(2 * np.pi) * self.spread)).sum())
        for side in self._sides(items, place):
            if self._m == 1 and len(reads) < len(item.costs) and side * item.u[0] > self._tolerance:
                continue  # the cost of the input alone would have chosen none
            if not inside:
                out.append(linear(np.empty((0, self._n)), unexplained, side))
                continue
            (facets,) = (f for f in self._law.facets if f.side == side)
            places = scales.width * facets.offsets
            y = item.u[0] - places
            r = exact + (SLACK * self.spread) ** 2 + (scales.doubt * places) ** 2
            S = ((facets.slopes @ Q) * facets.slopes).sum(axis=1) + r
            off = np.abs(predictions @ facets.slopes.T - y).min(axis=0)
            near = off <= REACH * np.sqrt(S)
            if heard:  # the tightest somewhere about the state
                limits = side * ((predictions + self._about) @ facets.slopes.T + places)
                near &= np.isin(np.arange(len(places)), limits.argmin(axis=1))
            if near.any():
                C = facets.slopes[near][:, None]
                out.append(Ways(C, y[near][:, None], r[near][:, None], 0.0, True, (side,)))
        return out

    def _sides(self, items: Sequence[Item], place: int) -> list[int]:
        """From where the constraints may bound an item."""
        if self._m > 1:
            return [1]
        return [s for s, at in ((-1, 0), (1, len(items) - 1)) if place == at]

    def allowed(self, x: Array, items: Sequence[Item], way: Ways, scales: Scales) -> Flags:
        """Whether the law offers this in states ``x``, shape (P, n), in this way."""
        soft = SLACK * self.spread + 4 * self._noise
        ok = np.ones(len(x), dtype=bool)
        for place, item in enumerate(items):
            held = way.bound[place]
            if not held:
                continue
            for i in item.costs:
                free = x @ self._law.free[i].T
                if self._m == 1:
                    ok &= held * (free[:, 0] - item.u[0]) >= -soft
                    continue
                for other in items:
                    if other is not item:  # every other candidate is a worse answer
                        step = self._law.curvature[i] @ (other.u - item.u)
                        ok &= (item.u - free) @ step >= -soft * np.linalg.norm(step)
        if way.inside and items:
            for facets in self._law.facets:
                u = float(items[-1 if facets.side == 1 else 0].u[0])
                places = scales.width * facets.offsets
                room = facets.side * (x @ facets.slopes.T + places - u)
                ok &= (room >= -3 * (soft + scales.doubt * np.abs(places))).all(axis=1)
        return ok
