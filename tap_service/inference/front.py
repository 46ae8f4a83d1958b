"""Which way of inferring what was missed suits what was heard, and the scales that it needs.

Where no offer was heard: by the readings (:mod:`tap_service.inference.unheard_offers`). A planar
plant with one input whose law bends nearly everywhere: by exact proposals
(:mod:`tap_service.inference.line_smoother`) and the law as the policy gives it. All else: by Kalman
filters (:mod:`tap_service.inference.beam_smoother`), who also find the width of D_c where no state
was heard beside an offer.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Final

import numpy as np

from protocol.arrays import Array
from protocol.knowledge import Knowledge
from tap_service.capture.transcript import Transition, steps_in_a_row
from tap_service.inference.beam_smoother import BeamSmoother
from tap_service.inference.fitted_shape import (
    SMALLEST,
    Shape,
    both_ways,
    likelier_shape,
    residuals_of,
)
from tap_service.inference.law import AffineLaw, KnownLaw, PlanarLaw, matching
from tap_service.inference.line_smoother import LineSmoother
from tap_service.inference.unheard_offers import infer_from_readings, unit_offsets
from tap_service.inference.verdicts import Inferred, thresholds_above

ENOUGH: Final = 16
"""Steps heard whole from which the disturbance is measured."""

EXPLAINED: Final = 1e-3
"""Over the spread of the answers: within this the law explains an offer."""

BLURRED: Final = 3.0
"""Standard deviations within which the law explains an offer that was read through noise."""

MOST_ACTIVE_SHARE: Final = 0.6
"""Share of the offers that a law must explain."""

TRIAL: Final = 120
"""Steps on which scales are tried."""

TRANSIENT: Final = 20
"""Steps at the start of a run, where the law aims at other sets than T_0."""

SHORT: Final = 60
"""Steps after these on which a width is looked for without any state."""

WIDTHS: Final = tuple(np.geomspace(1.0, 1 / 24, 10).tolist())
"""Of D_c over D_e, which are then tried first."""

FINER: Final = ((0.84, 0.92, 1.0, 1.09, 1.19), (0.97, 1.0, 1.03))
"""Times the best of them, which are then tried."""

SPREAD: Final = 0.85
"""Of the disturbance over D_c, meanwhile."""

DOUBT: Final = 0.013
"""By how much such a law's answers may be off, over their spread."""

ROUGHLY: Final = 1.2
"""Ratio within which a width is then known."""

SAMPLES: Final = 192
"""Trajectories drawn where the law is not known to the last digit."""

FEW: Final = 120
"""Particles while scales are tried."""


class Inference:
    """Infers transitions.

    Parameters
    ----------
    knowledge : Knowledge
        With a model.
    """

    def __init__(self, knowledge: Knowledge) -> None:
        k = knowledge
        assert k.disturbance_H is not None
        assert k.disturbance_h is not None
        self._A, self._B = np.array(k.A), np.array(k.B)
        self._told = np.array(k.disturbance_H) / np.array(k.disturbance_h)[:, None]
        self._shape, self._size = Shape(self._told), k.candidates
        # rounding to a step is an error spread evenly over it
        self._noise = float(np.hypot(k.noise, k.quantise / np.sqrt(12.0)))
        self._certain = k.policy is not None and k.policy.certain
        self._other_set = k.noisy  # than D_c, on which the law's facets depend, is tested by
        self._planar = PlanarLaw.of(k)
        self._offered: PlanarLaw | None = None  # of the width that offers alone showed
        self._law = KnownLaw.of(k)

    def gauges(self, t: Transition) -> list[float] | None:
        """Of each candidate of a step heard whole, in a shape that was learned; None before."""
        if self._shape.told is None:
            return None
        found: list[float] | None = self._shape.gauges(
            residuals_of(self._A, self._B, [t])[0]
        ).tolist()
        return found

    def infer(self, transitions: Sequence[Transition]) -> Inferred:
        """Infer the transcript that is kept, in one call."""
        runs = [_joined(run) for run in steps_in_a_row(transitions)]
        kept = [t for run in runs for t in run]
        if not self._noise:
            ties = self._certain or self._other_set
            self._shape = likelier_shape(self._told, self._A, self._B, kept, ties=ties)
        if self._law is not None and all(t.candidates is None for t in kept):
            A, B, noise = self._A, self._B, self._noise
            return infer_from_readings(
                A, B, self._told, self._law, self._size, noise, kept, self._planar
            )
        beam = self._beam(kept, runs)
        law = None if self._planar is None or beam.exact else self._fitted(self._planar, kept, runs)
        if law is not None:
            return self._by_lines(law, runs, kept)
        return Inferred(beam.infer(kept), thresholds_above(beam.support))

    def _beam(self, kept: Sequence[Transition], runs: Sequence[list[Transition]]) -> BeamSmoother:
        """By one Kalman filter, with the law as the policy or the offers have it."""
        law = AffineLaw.of(self._law, kept, self._noise)
        beam = BeamSmoother(self._A, self._B, self._told, self._shape, self._noise, law, SAMPLES)
        beam.learn(kept, max(runs, key=len), self._alphabet(law))
        return beam

    def _alphabet(self, law: AffineLaw | None) -> float:
        """D_c over D_e, by the distance of the candidates where these are apart for certain."""
        if law is None or not law.shared or not self._certain or self._other_set:
            return 1.0
        edge = 1 / np.abs(self._told).max(axis=0)
        offsets = law.g - law.g.mean(axis=0)
        found = [(1.0, np.inf)]
        for unit in unit_offsets(self._B, edge, self._size):
            scale = float((unit * offsets).sum() / (unit**2).sum())
            found.append((scale, float(np.abs(scale * unit - offsets).max())))
        return min(found, key=lambda one: one[1])[0]

    # --- the law ----------------------------------------------------------------------------------

    def _fitted(
        self, law: PlanarLaw, kept: Sequence[Transition], runs: Sequence[list[Transition]]
    ) -> PlanarLaw | None:
        """The law of the right width; None where it does not explain the offers."""
        if law.gap and self._noise:
            return None
        offers = [np.array(t.candidates) for t in kept if t.candidates is not None]
        law = matching(law, offers)
        pairs = [t for t in kept if t.x is not None and t.candidates is not None]
        if len(pairs) < ENOUGH:
            if not law.gap and not self._noise:
                law = self._by_evidence(law, max(runs, key=len))
            return law if law.gap or law.doubt else None
        x = np.array([t.x for t in pairs])
        u = np.array([law.solved(np.array(t.candidates)) for t in pairs])
        if self._noise:
            law = law.likeliest(x, u, self._noise)
            near = law.explains(x, u) <= BLURRED * law.blur(x, self._noise)
        else:
            law = law if law.gap else law.fitted(x, u)
            near = law.explains(x, u) <= EXPLAINED * max(float(u.std()), 1e-9)
        return law if near.mean() >= MOST_ACTIVE_SHARE else None

    def _by_evidence(self, law: PlanarLaw, run: Sequence[Transition]) -> PlanarLaw:
        """The law of the width that makes offers likeliest, where no state was heard with one."""
        if self._offered is not None:
            return self._offered
        trial = run[TRANSIENT : TRANSIENT + SHORT]
        offers = [law.solved(np.array(t.candidates)) for t in trial if t.candidates is not None]
        if len(offers) < ENOUGH:
            return law
        law = replace(law, spread=max(float(np.std(offers)), 1e-9))

        def evidence(width: float) -> float:
            of_width = law.of_width(width)
            beam = BeamSmoother(self._A, self._B, self._told, self._shape, 0.0, of_width, SAMPLES)
            return beam.evidence(trial, SPREAD * width)

        width = max(WIDTHS, key=evidence)
        for finer in FINER:
            width = max((min(width * ratio, 1.0) for ratio in finer), key=evidence)
        law = replace(law.of_width(width), doubt=DOUBT * law.spread)
        if len(trial) == SHORT:
            self._offered = law
        return law

    # --- by lines ---------------------------------------------------------------------------------

    def _by_lines(
        self, law: PlanarLaw, runs: Sequence[list[Transition]], kept: Sequence[Transition]
    ) -> Inferred:
        offers = [np.array(t.candidates) for t in kept if t.candidates is not None]
        spread = float(np.std([law.solved(offer) for offer in offers])) if offers else 0.0
        support = self._support(law, kept)
        longest = max(runs, key=len)

        def smoother(scale: float, particles: int | None = None) -> LineSmoother:
            more = {} if particles is None else {"particles": particles}
            return LineSmoother(
                self._A, self._B, self._shape, law, scale * support, self._noise, spread, **more
            )

        scale = 1.0
        if not self._measured(kept) and len(longest) > ENOUGH:
            trial = longest[:TRIAL]
            scale = max((1.0, 0.85, 0.7, 0.55, 0.4), key=lambda s: smoother(s, FEW).evidence(trial))
        line = smoother(scale)
        steps = [step for run in runs for step in line.infer(run)]
        if self._certain:
            return Inferred(steps, (0.0, 1.0))
        if not self._other_set and self._shape.told is None:
            exact = not self._noise and not law.doubt
            room = 1.0005 if exact else (ROUGHLY if law.doubt else 1.06)
            return Inferred(steps, (law.width / room, min(law.width * room, 1.0)))
        return Inferred(steps, thresholds_above(float(support.max())))

    def _measured(self, kept: Sequence[Transition]) -> bool:
        return not self._noise and sum(t.whole for t in kept) >= ENOUGH

    def _support(self, law: PlanarLaw, kept: Sequence[Transition]) -> Array:
        """The disturbance's support: ``shape @ d`` at most."""
        if not self._measured(kept):
            return np.full(len(self._told), law.width)
        whole = [t for t in kept if t.whole]
        rows = self._shape.rows
        products = residuals_of(self._A, self._B, whole) @ rows.T
        nearest = products[np.arange(len(whole)), products.max(axis=2).argmin(axis=1)]
        found: Array = nearest.max(axis=0) * (1 + 2 / len(whole))
        return np.maximum(both_ways(rows, found), SMALLEST)


def _joined(run: list[Transition]) -> list[Transition]:
    """A state that was heard after one step is the state before the next."""
    out = run[:1] + [
        t if t.x is not None or before.x_next is None else replace(t, x=before.x_next)
        for before, t in pairwise(run)
    ]
    return [
        t if t.x_next is not None or after.x is None else replace(t, x_next=after.x)
        for t, after in pairwise(out)
    ] + out[-1:]
