"""`text`: reads the message itself, by all that a frame and a language say of unreliable symbols.

What was missed is inferred as exactly as the law allows (:mod:`tap_service.inference.front`), and
where that leaves steps uncertain nothing is decoded step by step: each step keeps its
probabilities, and a search over whole messages weighs them together with what is expected of a text
(:mod:`tap_service.inference.expectation`), the frame's length, the silence after it and its check,
under the thresholds that are likely. She says how sure she is, and how many bits are left. She has
to hear what came after before she can infer what was lost, so she reads all that she keeps anew
each time she has heard twice as much as before and when a message should be over; where that cannot
be told, when she has heard a quarter more, and half more where it is over.
"""

from typing import ClassVar

from protocol.knowledge import Knowledge
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers.base import Model
from tap_service.eavesdroppers.reading import Reading
from tap_service.inference.front import Inference
from tap_service.inference.message_search import BEAM
from tap_service.inference.output_fit import refitted
from tap_service.inference.output_model import OutputModel
from tap_service.inference.verdicts import Inferred


class Text(Reading):
    """Reads whole messages, and says what is left of them."""

    name: ClassVar[str] = "text"
    searches: ClassVar[bool] = True
    first: ClassVar[int] = 96
    growth: ClassVar[float] = 2.0

    def __init__(
        self,
        knowledge: Knowledge,
        *,
        live: bool = True,
        beam: int = BEAM,
    ) -> None:
        super().__init__(knowledge, live=live, beam=beam)
        self.model = self._told = Model.of(knowledge, self.name)
        self._inference = Inference(knowledge)

    def gauges(self, transition: Transition) -> list[float] | None:
        """Of each candidate in the shape that was learned, else in that of D_e."""
        t = transition
        if t.x is None or t.candidates is None or t.x_next is None:
            return None
        learned = self._inference.gauges(t)
        if learned is not None:
            return learned
        measure = self._told.along_the_widest if self.knowledge.noisy else self._told.gauges
        return measure(t.x, t.candidates, t.x_next, t.predictions)

    def infer(self) -> Inferred:
        """By all that was heard."""
        return self._inference.infer(self.kept)

    def output_model(self) -> OutputModel | None:
        """The told model; where she hears badly with its widths fitted."""
        assert isinstance(self._told, OutputModel)
        if self.knowledge.noise or not all(t.whole for t in self.kept):
            return refitted(self._told, self.kept)
        return self._told
