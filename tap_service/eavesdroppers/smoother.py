"""`smoother`: decodes like `list-decoder` what she heard badly or in part.

She infers lost states and offers from later ones, as `text` does
(:mod:`tap_service.inference.front`), and follows every outcome that remains likely, beside every
threshold. She has to hear what came after before she can infer what
was lost, so she decodes all that she keeps anew each time she has heard twice as much as before.
Where outputs alone are read she finds how far disturbance and sensors scatter, and takes each
candidate for as likely as some readings later say; a lost offer she infers nothing of.
"""

from collections.abc import Sequence
from copy import deepcopy
from typing import ClassVar, Final

import numpy as np

from protocol.knowledge import Knowledge
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers.base import (
    Belief,
    Eavesdropper,
    Guess,
    MessageSymbols,
    Model,
    even,
    nearest,
)
from tap_service.eavesdroppers.by_readings import ByReadings
from tap_service.eavesdroppers.list_decoder import Collected
from tap_service.inference.front import Inference
from tap_service.inference.inferred import InferredStep
from tap_service.inference.list_decoding import ListDecoding
from tap_service.inference.output_model import OutputModel

KEPT: Final = 4096
"""Transitions that she keeps; at this many she lets the older half go, decoded for good."""

GROWTH: Final = 2.0
"""She decodes anew when she has heard this many times as much."""

FIRST: Final = 64
"""Transitions before she decodes for the first time."""

GRID: Final = 200
"""Thresholds by which the list is cut from the start: a blurred step cuts none."""

FINEST: Final = 0.0045
"""Relative distance of these thresholds at least."""

ALL: Final = (0.02, 1.0)
"""Thresholds from and to, in units of D_e, where nothing is known of them."""


class Smoother(Eavesdropper):
    """Infers what was missed, then decodes with every threshold and every likely outcome."""

    name: ClassVar[str] = "smoother"
    heavy: ClassVar[bool] = True

    def __init__(self, knowledge: Knowledge) -> None:
        super().__init__(knowledge)
        self._model = told = Model.of(knowledge, self.name)
        self._readings: ByReadings | None = None
        if isinstance(told, OutputModel):
            self._readings = ByReadings.refitting(
                self.scheme, told, each=False, first=FIRST, growth=GROWTH, kept=KEPT
            )
            self.final_guesses = self._readings.final_guesses
        self._even = even(self.size)
        self._inference = Inference(knowledge)
        self._kept: list[Transition] = []
        self._before: ListDecoding | None = None
        self._collected = Collected()
        self._next = FIRST
        self._heard = 0
        self._decoded = 0
        self._steps: list[InferredStep] = []
        self._among = ALL
        self._decoding = self._new_decoding(None)

    def _new_decoding(self, among: tuple[float, float] | None) -> ListDecoding:
        """A list of thresholds from and to, or of all where every step was heard."""
        decoding = ListDecoding(self.scheme, edge=1.0, certain=self.certain)
        low, high = among or ALL
        if among:
            decoding.restrict(low, high, 1.0, float(np.nextafter(1.0, 2.0)))
        count = min(2 + int(np.log(high / low) / FINEST), GRID)
        decoding.split_evenly(np.geomspace(low, high, count)[1:-1].tolist())
        return decoding

    def observe(self, transition: Transition) -> Guess:
        """Take the nearest candidate where the step was heard; what was lost must wait."""
        if self._readings is not None:
            return self._readings.observe(transition)
        t = transition
        self._kept.append(t)
        self._heard += 1
        if self._heard >= self._next:
            self.decode()
            self._next = self._heard + min(int(self._heard * (GROWTH - 1)), KEPT // 2)
        if len(self._kept) >= KEPT:
            self._let_go(KEPT // 2)
        if t.x is None or t.candidates is None or t.x_next is None:
            return Guess(t.k, self._even, 0.5)
        gauges = self._model.gauges(t.x, t.candidates, t.x_next, t.predictions)
        return Guess(t.k, nearest(gauges), 0.5 if max(gauges) <= 1.0 else 0.0)

    def decode(self) -> None:
        """Infer and decode all that is kept, from where what was let go leaves off."""
        if self._decoded == self._heard:
            return
        self._decoded = self._heard
        self._among = self._infer()
        if all(t.cipher is None for t in self._kept):
            return  # the message is safe from her
        self._decoding = self._follow(self._steps)
        self._collected.take(self._decoding, self._kept[-1].k)

    def _let_go(self, count: int) -> None:
        """Decode the oldest for good."""
        self.decode()
        oldest = self._steps[:count]
        self.final_guesses += [self._second_thought(step) for step in oldest]
        if any(t.cipher is not None for t in self._kept):
            self._before = self._follow(oldest)
        self._kept, self._steps = self._kept[count:], self._steps[count:]

    def _follow(self, steps: Sequence[InferredStep]) -> ListDecoding:
        """The list after these steps, which come right after what was let go."""
        if self._before is None:
            clear = all(s.samples is not None and len(s.samples) == 1 for s in self._steps)
            decoding = self._new_decoding(None if clear else self._among)
        else:
            decoding = deepcopy(self._before)
        for step in steps:
            t = step.transition
            if t.start or t.gap:
                decoding.restart()
            decoding.session = t.session
            if step.samples is None:
                blind = np.full((1, self.size), np.inf)
                decoding.step_sampled(t.k, blind, t.cipher)
            elif len(step.samples) == 1 and t.cipher is not None:
                decoding.step(t.k, step.samples[0].tolist(), t.cipher)
            else:
                decoding.step_sampled(t.k, step.samples, t.cipher)
        return decoding

    def _infer(self) -> tuple[float, float]:
        """Infer what is kept by what was heard of it; the thresholds that remain, in units of D_e.

        A little lower than those of one who weighs the steps: what is inferred may be too wide.
        """
        found = self._inference.infer(self._kept)
        self._steps, (low, high) = found.steps, found.among
        return max(0.5 * low, ALL[0]), high

    def review(self) -> Sequence[Guess]:
        """What she takes each step for, with what came after it."""
        if self._readings is not None:
            return self._readings.review()
        self.decode()
        return [self._second_thought(step) for step in self._steps]

    def _second_thought(self, step: InferredStep) -> Guess:
        t = step.transition
        if step.samples is None:
            return Guess(t.k, self._even, 0.5, t.session)
        counts = np.bincount(step.samples.argmin(axis=1), minlength=self.size)
        return Guess(t.k, tuple((counts / counts.sum()).tolist()), 0.5, t.session)

    def belief(self) -> Belief:
        """The last whole message, else what the best decoding spells so far."""
        if self._readings is not None:
            return self._readings.belief()
        if self._collected.solved_k < 0:
            self.decode()
        return self._collected.belief(self._decoding, self._model)

    def message_symbols(self) -> MessageSymbols:
        """Those of her best decoding."""
        decoded = self._decoding if self._readings is None else self._readings
        return decoded.message_symbols()
