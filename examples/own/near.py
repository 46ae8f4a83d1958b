"""Eve takes the candidate whose centre lies nearest to x(k+1), and follows the scheme.

Eve then names nearly every key and reads no message: each agreement that is guessed wrongly puts
the later bits out of place. ``list-decoder`` follows every threshold, and reads it.
"""

from protocol.agreement import NO_SYMBOL
from tap_service.eavesdroppers import Belief, Eavesdropper, Guess
from tap_service.eavesdroppers.base import Follower, Model


class Near(Eavesdropper):
    name = "near"

    def __init__(self, knowledge):
        super().__init__(knowledge)  # gives self.size (M) and self.scheme
        self.model = Model.of(knowledge, self.name)
        self.follower = Follower(self.scheme)

    def observe(self, t):
        if t.start or t.gap:
            self.follower.restart()
        if not t.whole:  # something of this step was missed
            self.follower.step(t.k, NO_SYMBOL, t.cipher)
            return Guess(t.k, (1 / self.size,) * self.size, agreed=0.5)
        gauges = self.model.gauges(t.x, t.candidates, t.x_next)
        best = gauges.index(min(gauges))
        agreed = 5 * gauges[best] < sorted(gauges)[1]  # a guess at when a key was agreed
        self.follower.step(t.k, best if agreed else NO_SYMBOL, t.cipher)
        return Guess(t.k, tuple(float(i == best) for i in range(self.size)), float(agreed))

    def belief(self) -> Belief:
        return self.follower.belief(self.model)

    def message_symbols(self):  # for scoring, once at the end
        return self.follower.message_symbols()
