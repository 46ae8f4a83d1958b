"""`learning`: starts from nothing, or from a wrong model, and learns the plant while it decodes.

She is told the number of candidates and nothing else that matters: no A, no B, no D_e. She
identifies the model and the disturbance's support from the transcript
(:mod:`tap_service.inference.identification`) and decodes it with both thresholds hidden
(:mod:`tap_service.inference.list_decoding`), in units of the support that she found. Each time she
has heard a quarter more she learns again and decodes what she keeps anew, so that what she misread
at first is read in the end. Where outputs alone are read she learns how readings follow from
readings and inputs before them (:mod:`tap_service.inference.output_fit`), and not even the number
of states.
"""

from typing import ClassVar, Final

import numpy as np

from protocol.agreement import Gauge
from protocol.arrays import Array
from protocol.knowledge import Knowledge
from protocol.vectors import Matrix
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers.base import Model
from tap_service.eavesdroppers.reading import Reading
from tap_service.inference.identification import identify
from tap_service.inference.list_decoding import ANY_EDGE
from tap_service.inference.output_fit import identified
from tap_service.inference.output_model import OutputModel
from tap_service.inference.verdicts import Inferred, Interval

SMALL_OFFSET: Final = 0.1
"""Offset over half-width below which she takes the disturbance for centred."""

PARAMETERS: Final = 3
"""Steps that she hears whole for each unknown of a row before she learns for the first time."""


class Learning(Reading):
    """Identifies the model as she listens, and decodes her past again with what she learned."""

    name: ClassVar[str] = "learning"
    told_model: ClassVar[bool] = False
    among: ClassVar[Interval] = (0.98, 2.0)
    """Over the support that she found: the disturbance fills half its set at least."""

    edges: ClassVar[Interval] = ANY_EDGE
    first: ClassVar[int] = 8

    def __init__(self, knowledge: Knowledge) -> None:
        super().__init__(knowledge)
        self._offset = np.zeros(0)
        if knowledge.A is not None and knowledge.B is not None and knowledge.C is None:
            widths = (1.0,) * len(knowledge.A)
            self.model = Model(knowledge.A, knowledge.B, Gauge(half_widths=widths))
            self._offset = np.zeros(len(widths))
        told = isinstance(self.model, Model)
        self._starts = [(np.array(knowledge.A), np.array(knowledge.B))] if told else []

    def gauges(self, transition: Transition) -> list[float] | None:
        """Of each candidate, by the model that she has."""
        t = transition
        if self.model is None or t.x is None or t.candidates is None or t.x_next is None:
            return None
        # a steady disturbance is part of her model, though not of the defender's
        x_next = (np.array(t.x_next) - self._offset).tolist()
        return self.model.gauges(t.x, t.candidates, x_next)

    def infer(self) -> Inferred:
        """Learn from all that is kept; then the gauges of the steps that were heard whole."""
        whole = [t for t in self.kept if t.whole]
        if whole and whole[0].x is not None and whole[0].candidates is not None:
            unknowns = len(whole[0].x) + len(whole[0].candidates[0]) + 1
            if len(whole) >= PARAMETERS * unknowns:
                self._learn(whole)
        return super().infer()

    def _learn(self, whole: list[Transition]) -> None:
        """Identify the model from steps that were heard whole."""
        x = np.array([t.x for t in whole])
        candidates = np.array([t.candidates for t in whole])
        x_next = np.array([t.x_next for t in whole])
        starts = list(self._starts)
        if self.model is not None:
            starts.append((np.array(self.model.A), np.array(self.model.B)))
        fit = identify(x, candidates, x_next, starts)
        self._offset = np.where(np.abs(fit.offset) < SMALL_OFFSET * fit.widths, 0.0, fit.offset)
        self.model = Model(
            _rows(fit.A), _rows(fit.B), Gauge(half_widths=tuple(fit.widths.tolist()))
        )

    def output_model(self) -> OutputModel | None:
        """How readings follow from readings and inputs before them."""
        before = self.model if isinstance(self.model, OutputModel) else None
        return identified(self.kept, self.knowledge.noise, before)


def _rows(matrix: Array) -> Matrix:
    return tuple(tuple(row) for row in matrix.tolist())
