"""States and applied candidates from offers, for one who knows the control policy.

A particle smoother (:mod:`tap_service.inference.particle_smoother`) does it for given scales. Two
are learned, as those that make the offers likeliest: the width of D_c, on which the facets depend,
and that of the disturbance, which is taken for even over the shape of D_e.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Final

import numpy as np

from protocol.arrays import Array
from tap_service.capture.transcript import Transition, steps_in_a_row
from tap_service.inference.active_sets import Scales
from tap_service.inference.inferred import InferredStep
from tap_service.inference.particle_smoother import PARTICLES, ParticleSmoother
from tap_service.inference.policy import KnownLaw

FEW: Final = 120
"""The same while scales are tried."""

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


class OffersReader(ParticleSmoother):
    """Infers what was applied from offers and the states heard beside them, with the law known.

    The parameters are those of :class:`ParticleSmoother`.
    """

    def __init__(self, A: Array, B: Array, shape: Array, law: KnownLaw, noise: float) -> None:
        super().__init__(A, B, shape, law, noise)
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
        _, off = self.width_of(*pairs)
        slopes = np.concatenate([np.linalg.norm(f.slopes, axis=1) for f in self._law.facets])
        return off <= EXPLAINED * float(pairs[1].std()) + 2 * self._noise * float(np.median(slopes))

    def width_of(self, x: Array, u: Array) -> tuple[float, float]:
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
        width, _ = self.width_of(*pairs)
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
