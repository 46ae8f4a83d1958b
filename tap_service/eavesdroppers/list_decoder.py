"""`list-decoder`: sweeps the hidden threshold and keeps every decoding that is consistent.

She knows f_c and D_e (model 10), so t_e = 1 in units of D_e, and only t_c = 1 / alpha is hidden.
Over N steps at most 2N + 1 thresholds give different decodings. She makes them all
(:mod:`tap_service.inference.list_decoding`), and the frame's check picks the one. The key symbols
are the nearest candidates', as for `nearest-centre`. What she missed she does not infer: such a
step counts as one without an agreement.
"""

from typing import ClassVar

import numpy as np

from protocol.knowledge import Knowledge
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers.base import Model
from tap_service.eavesdroppers.reading import Reading
from tap_service.inference.inferred import Inferred, InferredStep


class ListDecoder(Reading):
    """Follows every threshold at once and ranks by frame check and plausibility."""

    name: ClassVar[str] = "list-decoder"
    follows: ClassVar[bool] = True

    def __init__(self, knowledge: Knowledge, *, live: bool = True) -> None:
        super().__init__(knowledge, live=live)
        self.model = Model.of(knowledge, self.name)
        self._steps: list[InferredStep] = []

    def infer(self) -> Inferred:
        """The gauges of the steps that were heard whole."""
        known = {id(step.transition): step for step in self._steps}
        self._steps = [known.get(id(t)) or self._step(t) for t in self.kept]
        return Inferred(self._steps, (0.0, 1.0))

    def _step(self, t: Transition) -> InferredStep:
        gauges = self.gauges(t)
        return InferredStep(t, None if gauges is None else np.array([gauges]))
