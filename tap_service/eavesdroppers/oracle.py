"""`oracle`: knows what the defender knows, and so must always succeed on a lossless tap.

She is the measurement's own control: D_c = D_e / alpha gives her the very test that both ends make.
A scheme that she fails against is a broken measurement.
"""

from typing import ClassVar

from protocol.agreement import NO_SYMBOL, AgreementRule, Gauge
from protocol.knowledge import Knowledge
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers.base import (
    Belief,
    Eavesdropper,
    Follower,
    Guess,
    KnowledgeError,
    Model,
    even,
)


class Oracle(Eavesdropper):
    """Makes the defender's own test."""

    name: ClassVar[str] = "oracle"

    def __init__(self, knowledge: Knowledge) -> None:
        super().__init__(knowledge)
        self._model = Model.of(knowledge, self.name)
        if knowledge.alpha is None:
            raise KnowledgeError(f"eavesdropper {self.name}: knowledge lacks alpha")
        assert knowledge.disturbance_H is not None
        assert knowledge.disturbance_h is not None
        h = tuple(b / knowledge.alpha for b in knowledge.disturbance_h)
        gauge = Gauge.from_rows(knowledge.disturbance_H, h)
        self._rule = AgreementRule(self._model.A, self._model.B, gauge, knowledge.alpha)
        self._even = even(self.size)
        self._follower = Follower(self.scheme)

    def observe(self, transition: Transition) -> Guess:
        """Make the test and follow the scheme."""
        t = transition
        if t.start or t.gap:
            self._follower.restart()
        if t.x is None or t.candidates is None or t.x_next is None:
            self._follower.step(t.k, NO_SYMBOL, t.cipher)
            return Guess(t.k, self._even, 0.5)
        if t.centres:
            verdict = self._rule.verdict_at(t.centres, t.x_next)
        else:
            verdict = self._rule.verdict(t.x, t.candidates, t.x_next)
        agreed = verdict.agreed and self._follower.tests
        self._follower.step(t.k, verdict.symbol, t.cipher)
        symbol = verdict.gauges.index(min(verdict.gauges))
        certain = tuple(1.0 if i == symbol else 0.0 for i in range(len(verdict.gauges)))
        return Guess(t.k, certain, float(agreed))

    def belief(self) -> Belief:
        """The message, as the plant has it."""
        return self._follower.belief(self._model, 1.0)
