"""`oracle`: knows what the defender knows, and so must always succeed on a lossless tap.

She is the measurement's own control: D_c = D_e / alpha, or D_c itself where D_e
has a shape of its own, gives her the very test that both ends make.
A scheme that she fails against is a broken measurement.
"""

from collections.abc import Sequence
from typing import ClassVar

from protocol.agreement import AgreementRule, Gauge
from protocol.knowledge import Knowledge
from protocol.vectors import Vector
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers.base import Belief, Following, Guess, KnowledgeError, nearest


class Oracle(Following):
    """Makes the defender's own test."""

    name: ClassVar[str] = "oracle"
    reads_outputs: ClassVar[bool] = False
    corrects: ClassVar[bool] = True

    def __init__(self, knowledge: Knowledge) -> None:
        super().__init__(knowledge)
        if knowledge.alpha is None:
            raise KnowledgeError(f"{self.name}: knowledge lacks alpha")
        assert knowledge.disturbance_H is not None
        assert knowledge.disturbance_h is not None
        h = tuple(b / knowledge.alpha for b in knowledge.disturbance_h)
        gauge, reach = Gauge.from_rows(knowledge.disturbance_H, h), None
        if knowledge.defender_H is not None and knowledge.defender_h is not None:
            reach = gauge  # D_e has a shape of its own, or W takes D_c's place
            gauge = Gauge.from_rows(knowledge.defender_H, knowledge.defender_h)
        apart = None
        if knowledge.noisy:
            reach, apart = None, reach
        self._rule = AgreementRule(
            self.model.A,
            self.model.B,
            gauge,
            knowledge.alpha,
            reach,
            apart,
            knowledge.deviations,
        )

    def judged(
        self, t: Transition, x: Vector, candidates: Sequence[Vector], x_next: Vector
    ) -> tuple[int, Guess]:
        """Make the test."""
        if t.predictions:
            verdict = self._rule.verdict_at(t.predictions, x_next)
        else:
            verdict = self._rule.verdict(x, candidates, x_next)
        agreed = verdict.agreed and self.follower.tests
        return verdict.symbol, Guess(t.k, nearest(verdict.gauges), float(agreed))

    def belief(self) -> Belief:
        """The message, as the plant has it."""
        return self.follower.belief(self.model, 1.0)
