"""`fitted-box`: learns the shape of the disturbance, and decides in that.

`nearest-centre` measures in the shape of D_e. That names every key where D_e is a multiple of D_c,
and not where it is wider in one direction than in another: a coordinate that tells nothing of the
input may then outweigh the one that decides. She needs no D_c for more. Whatever was applied left
its disturbance in one set; so she looks for the smallest set, with facets along those of D_e, that
holds one residual of every step (:mod:`tap_service.inference.fitted_shape`). Where outputs alone
are read no step shows its residual: she takes the widths under which the readings are likeliest.
"""

import math
from collections.abc import Sequence
from typing import ClassVar, Final

import numpy as np

from protocol.agreement import NO_SYMBOL, Gauge, predict
from protocol.arrays import Array
from protocol.knowledge import Knowledge
from protocol.vectors import Vector
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers.base import Belief, Follower, Following, Guess, MessageSymbols
from tap_service.eavesdroppers.by_readings import ByReadings
from tap_service.inference.fitted_shape import fitted_widths
from tap_service.inference.output_model import OutputModel

KEPT: Final = 2048
"""Transitions that she fits to; at this many the older half goes."""

GROWTH: Final = 1.25
"""She fits again when she has heard this many times as much."""

FIRST: Final = 8
"""Transitions before she fits for the first time."""

MARGIN: Final = 1.1
"""Threshold over the fitted widths: a defender's set is drawn with room to spare."""


class FittedBox(Following):
    """Takes the nearest candidate in the shape that she found."""

    name: ClassVar[str] = "fitted-box"
    heavy: ClassVar[bool] = True

    def __init__(self, knowledge: Knowledge) -> None:
        super().__init__(knowledge)
        self._readings: ByReadings | None = None
        told = self.model
        if isinstance(told, OutputModel):
            self._readings = ByReadings.refitting(
                self.scheme, told, each=True, first=FIRST, growth=GROWTH, kept=KEPT
            )
            self.final_guesses = self._readings.final_guesses
        assert knowledge.disturbance_H is not None
        assert knowledge.disturbance_h is not None
        self._rows = np.array(knowledge.disturbance_H) / np.array(knowledge.disturbance_h)[:, None]
        self.widths: Array = np.ones(len(self._rows))
        """Of what she found, along each facet of D_e and in units of D_e."""
        self._kept: list[tuple[Transition, Array | None]] = []
        self._whole_past = True
        self._heard = 0
        self._next = FIRST

    def observe(self, transition: Transition) -> Guess:
        """Follow the scheme; each fit decodes anew what is kept, while that is the whole past."""
        if self._readings is not None:
            return self._readings.observe(transition)
        if not transition.whole:
            self._kept.append((transition, None))
        guess = super().observe(transition)
        if self._heard >= self._next:
            self._fit()
            self._next = max(self._heard + 1, math.ceil(self._heard * GROWTH))
        if len(self._kept) >= KEPT:
            self._fit()
            oldest, self._kept = self._kept[: KEPT // 2], self._kept[KEPT // 2 :]
            self._whole_past = False
            self.final_guesses += [self._guess(past, along) for past, along in oldest]
        return guess

    def judged(
        self, t: Transition, x: Vector, candidates: Sequence[Vector], x_next: Vector
    ) -> tuple[int, Guess]:
        """Measure every candidate in the shape found so far; the nearest is the guess."""
        A, B = self.model.A, self.model.B
        predictions = t.predictions or [predict(A, B, x, u) for u in candidates]
        along = (np.array(x_next) - np.array(predictions)) @ self._rows.T
        self._kept.append((t, along))
        self._heard += 1
        guess = self._guess(t, along)
        return (guess.best if guess.agreed else NO_SYMBOL), guess

    def _guess(self, t: Transition, along: Array | None) -> Guess:
        if along is None:
            return Guess(t.k, self.even, 0.5, t.session)
        gauges = np.maximum(0.0, (along / self.widths).max(axis=1))
        nearest = float(gauges.min())
        inside = int((gauges <= MARGIN * max(1.0, nearest)).sum())
        possible = bool((along <= 1.0).all())
        agreed = self.certain or (inside == 1 and possible)
        share = (gauges == nearest) / (gauges == nearest).sum()
        return Guess(t.k, tuple(share.tolist()), float(agreed), t.session)

    def _fit(self) -> None:
        """The smallest set that holds a residual of every step kept, from several starts."""
        heard = [along for _, along in self._kept if along is not None]
        if not heard:
            return
        self.widths = fitted_widths(np.array(heard))
        if not self._whole_past:
            return
        self.follower = Follower(self.scheme)
        for t, along in self._kept:
            if t.start or t.gap:
                self.follower.restart()
            guess = self._guess(t, along)
            agreed = along is not None and guess.agreed > 0
            self.follower.step(t.k, guess.best if agreed else NO_SYMBOL, t.cipher)

    def review(self) -> Sequence[Guess]:
        """Her guesses of the steps she kept, in the shape that she has now."""
        if self._readings is not None:
            return self._readings.review()
        self._fit()
        return [self._guess(t, along) for t, along in self._kept]

    def belief(self) -> Belief:
        """The message that her verdicts spell."""
        return super().belief() if self._readings is None else self._readings.belief()

    def message_symbols(self) -> MessageSymbols:
        """What her verdicts make of the ciphertext."""
        if self._readings is None:
            return super().message_symbols()
        return self._readings.message_symbols()

    @property
    def gauge(self) -> Gauge:
        """The set that she found."""
        H, h = self.knowledge.disturbance_H, self.knowledge.disturbance_h
        assert H is not None
        assert h is not None
        found = (self.widths * np.array(h)).tolist()
        return Gauge(H=H, h=tuple(found))
