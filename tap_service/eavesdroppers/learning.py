"""`learning`: starts from nothing, or from a wrong model, and learns the plant while it decodes.

She is told the number of candidates and nothing else that matters: no A, no B, no D_e. She
identifies the model and the disturbance's support from the transcript
(:mod:`tap_service.inference.identification`) and decodes it with both thresholds hidden
(:mod:`tap_service.inference.list_decoding`), in units of the support that she found. Each time she
has heard a quarter more she learns again and decodes her past anew, so that what she misread at
first is read in the end. When she has heard as much as she keeps, the past stays as she read it
last: she goes on learning A and B, measures in the support that she has found by then, and decodes
on from where she is. Where outputs alone are read she learns how readings follow from readings and
inputs before them (:mod:`tap_service.inference.output_fit`), and not even the number of states.
"""

from collections.abc import Sequence
from typing import ClassVar, Final

import numpy as np

from protocol.agreement import Gauge
from protocol.arrays import Array
from protocol.knowledge import Knowledge
from protocol.vectors import Matrix
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers.base import Belief, Eavesdropper, Guess, MessageSymbols, Model, even
from tap_service.eavesdroppers.by_readings import ByReadings
from tap_service.eavesdroppers.list_decoder import Collected, agreement_probability
from tap_service.inference.identification import identify
from tap_service.inference.list_decoding import ListDecoding
from tap_service.inference.output_fit import identified

KEPT: Final = 4096
"""Transitions that she keeps to learn from; at this many the older half goes."""

GROWTH: Final = 1.25
"""She learns again when she has heard this many times as much."""

CAP: Final = 800
"""Hypotheses she keeps while she decodes her past anew again and again: with two thresholds hidden
the list always fills its bound."""

NEAR: Final = 1.2
"""Factor about thresholds that once gave a message within which she looks from then on."""

ERROR: Final = 1.001
"""Factor by which a gauge may be wrong for what her model still is; twice what was measured."""

FIRST_BY_READINGS: Final = 24
"""Transitions before she learns for the first time where outputs alone are read."""

GROWTH_BY_READINGS: Final = 1.5
"""She learns again when she has heard this many times as much of these."""

SMALL_OFFSET: Final = 0.1
"""Offset over half-width below which she takes the disturbance for centred."""


class Learning(Eavesdropper):
    """Identifies the model as she listens, and decodes her past again with what she learned."""

    name: ClassVar[str] = "learning"
    heavy: ClassVar[bool] = True
    told_model: ClassVar[bool] = False

    def __init__(self, knowledge: Knowledge) -> None:
        super().__init__(knowledge)
        self._readings: ByReadings | None = None
        if knowledge.C is not None:
            self._readings = ByReadings(
                self.scheme,
                lambda heard, before: identified(heard, knowledge.noise, before),
                first=FIRST_BY_READINGS,
                growth=GROWTH_BY_READINGS,
                kept=KEPT,
            )
            self.final_guesses = self._readings.final_guesses
        self._even = even(self.size)
        self._kept: list[Transition] = []
        self._past_stays = False
        self._collected = Collected()
        self._heard = 0
        self._next_fit = 0
        self._model: Model | None = None
        self._offset: tuple[float, ...] = ()
        self._start = None
        if knowledge.A is not None and knowledge.B is not None:
            self._start = (np.array(knowledge.A), np.array(knowledge.B))
            widths = (1.0,) * len(knowledge.A)
            self._model = Model(knowledge.A, knowledge.B, Gauge(half_widths=widths))
            self._offset = (0.0,) * len(knowledge.A)
        self._found: tuple[float, float, float, float] | None = None
        self._decoding = ListDecoding(self.scheme, cap=CAP)

    def observe(self, transition: Transition) -> Guess:
        """Guess with what she has learned so far, then learn from the step."""
        if self._readings is not None:
            return self._readings.observe(transition)
        t = transition
        self._kept.append(t)
        self._heard += t.whole
        guess = self._decode(self._decoding, t)
        if self._next_fit == 0 and t.x is not None and t.candidates is not None:
            parameters = len(t.x) + len(t.candidates[0]) + 1
            self._next_fit = 3 * parameters
        if self._next_fit and self._heard >= self._next_fit:
            self.learn()
            self._next_fit = self._heard + min(max(8, int(self._heard * (GROWTH - 1))), KEPT // 4)
        self._collected.take(self._decoding, t.k)
        if len(self._kept) >= KEPT:
            self._let_go(KEPT // 2)
        return guess

    def _let_go(self, count: int) -> None:
        """Learn from all that is kept once more, and keep the newer ones to learn from."""
        self.learn()
        self.final_guesses += map(self._second_thought, self._kept[:count])
        self._past_stays = self._model is not None
        self._kept = self._kept[count:]

    def learn(self) -> None:
        """Identify the model from all that is kept; while it is the whole past, decode it anew."""
        whole = [t for t in self._kept if t.whole]
        if not whole:
            return
        x = np.array([t.x for t in whole])
        candidates = np.array([t.candidates for t in whole])
        x_next = np.array([t.x_next for t in whole])
        starts = [] if self._start is None else [self._start]
        if self._model is not None:
            starts.append((np.array(self._model.A), np.array(self._model.B)))
        fit = identify(x, candidates, x_next, starts)
        offset = np.where(np.abs(fit.offset) < SMALL_OFFSET * fit.widths, 0.0, fit.offset)
        self._offset = tuple(offset.tolist())
        if self._past_stays and self._model is not None:
            # thresholds are in units of the support found before
            self._model = Model(_rows(fit.A), _rows(fit.B), self._model.gauge)
            self._decoding.widen(ERROR)
            return
        gauge = Gauge(half_widths=tuple(fit.widths.tolist()))
        self._model = Model(_rows(fit.A), _rows(fit.B), gauge)
        found = self._decoding.thresholds() if self._decoding.whole_count else self._found
        self._found = found
        full = len(self._kept) >= KEPT  # decoded for the last time
        self._decoding = ListDecoding(self.scheme) if full else ListDecoding(self.scheme, cap=CAP)
        if found is not None:  # she found a message with these: others are near, in any unit
            lo, hi, edge_lo, edge_hi = found
            self._decoding.restrict(lo / NEAR, hi * NEAR, edge_lo / NEAR, edge_hi * NEAR)
        for t in self._kept:
            self._decode(self._decoding, t)
        self._collected.take(self._decoding, self._kept[-1].k)

    def _gauges(self, t: Transition) -> list[float] | None:
        if self._model is None or t.x is None or t.candidates is None or t.x_next is None:
            return None
        # a steady disturbance is part of her model, though not of the defender's
        x_next = [a - o for a, o in zip(t.x_next, self._offset, strict=True)]
        return self._model.gauges(t.x, t.candidates, x_next)

    def _decode(self, decoding: ListDecoding, t: Transition) -> Guess:
        if t.start or t.gap:
            decoding.restart()
        decoding.session = t.session
        gauges = self._gauges(t)
        if gauges is None or t.cipher is None:
            decoding.step_missed(t.k, t.cipher)
            return Guess(t.k, self._even, 0.5)
        agreed = agreement_probability(decoding, gauges)
        decoding.step(t.k, gauges, t.cipher)
        return Guess(t.k, self._shares(gauges), agreed)

    def _shares(self, gauges: list[float]) -> tuple[float, ...]:
        """Probability of each candidate, for a Gaussian of the support's own deviation."""
        smallest = min(gauges)
        weights = np.exp(-1.5 * (np.square(gauges) - smallest**2))
        return tuple((weights / weights.sum()).tolist())

    def review(self) -> Sequence[Guess]:
        """Her guesses of the steps she kept, with the model that she has now."""
        if self._readings is not None:
            return self._readings.review()
        self.learn()
        return [self._second_thought(t) for t in self._kept]

    def _second_thought(self, t: Transition) -> Guess:
        gauges = self._gauges(t)
        shares = self._even if gauges is None else self._shares(gauges)
        return Guess(t.k, shares, 0.5, t.session)

    def belief(self) -> Belief:
        """The last whole message, the model, and what there is of the message under way."""
        if self._readings is not None:
            return self._readings.belief()
        return self._collected.belief(self._decoding, self._model)

    def message_symbols(self) -> MessageSymbols:
        """Those of her best decoding."""
        decoded = self._decoding if self._readings is None else self._readings
        return decoded.message_symbols()


def _rows(matrix: Array) -> Matrix:
    return tuple(tuple(row) for row in matrix.tolist())
