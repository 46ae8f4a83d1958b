"""An eavesdropper of one's own: it takes the candidate whose prediction is nearest in speed."""

from protocol.agreement import predict
from wyner import Belief, Eavesdropper, Guess, Transition, eavesdrop, run


class SpeedWatcher(Eavesdropper):
    """She is told f_c and looks at the second state only."""

    name = "speed-watcher"

    def observe(self, transition: Transition) -> Guess:
        """Take the candidate that explains x_2(k+1) best."""
        t, k = transition, self.knowledge
        if not t.whole:
            return Guess(t.k, (0.5, 0.5), 0.5)
        away = [abs(t.x_next[1] - predict(k.A, k.B, t.x, u)[1]) for u in t.candidates]
        best = away.index(min(away))
        return Guess(t.k, tuple(float(i == best) for i in range(self.size)), 1.0)

    def belief(self) -> Belief:
        """She does not read messages."""
        return Belief()


# Only where this file is the program: a live tap and a sweep load it for the class.
if __name__ == "__main__":
    runs = run("sustained", steps=500, runs=4, seed=6)
    for tap in eavesdrop(runs, [SpeedWatcher, "nearest-centre"]):
        print(f"{tap.name:16} {tap.right} of {tap.agreements} key symbols")
