"""A channel of two states, good and bad (Gilbert 1960, Elliott 1963)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from protocol.secret.bound import GUARD

LONGEST_LOOK: Final = 10_000
"""Steps by which the state is looked for in the past; before that it is drawn afresh."""


@dataclass(frozen=True, slots=True)
class GilbertElliott:
    """A channel of two states, each with its own probability of a loss.

    Parameters
    ----------
    loss_good, loss_bad : float
        e_G and e_B, the probabilities that a message is lost.
    to_bad, to_good : float
        g and b, the probabilities of a change of state from one step to the next.
    """

    loss_good: float
    loss_bad: float
    to_bad: float = 0.0
    to_good: float = 1.0

    @property
    def bad_share(self) -> float:
        """The share of steps in the bad state in the long run."""
        return self.to_bad / (self.to_bad + self.to_good) if self.to_bad else 0.0

    @property
    def mean(self) -> float:
        """The share lost in the long run."""
        bad = self.bad_share
        return (1 - bad) * self.loss_good + bad * self.loss_bad

    @property
    def eps_inf(self) -> float:
        """The least probability of a loss given any past."""
        g, b = self.to_bad, self.to_good
        return min(
            (1 - g) * self.loss_good + g * self.loss_bad,
            b * self.loss_good + (1 - b) * self.loss_bad,
        )

    def bad_at(self, k: int, uniform: Callable[[int], float]) -> bool:
        """Whether step ``k`` is in the bad state, for ``to_bad`` + ``to_good`` at most 1.

        A step whose uniform number is below ``to_bad`` is bad whatever came before, one below the
        sum of both is good, and any other is as the step before: the chain, found from its end.

        Parameters
        ----------
        k : int
        uniform : callable
            The number in [0, 1) of a step, the same whenever it is asked; -1 is asked for a start.
        """
        if not self.to_bad:
            return False
        for step in range(k, max(k - LONGEST_LOOK, -1), -1):
            drawn = uniform(step)
            if drawn < self.to_bad + self.to_good:
                return drawn < self.to_bad
        return uniform(-1) < self.bad_share

    def loss_at(self, k: int, uniform: Callable[[int], float]) -> float:
        """The probability of a loss in step ``k``; parameters as of :meth:`bad_at`."""
        return self.loss_bad if self.bad_at(k, uniform) else self.loss_good

    def tails(self, n: int, most: int) -> list[float]:
        """P[fewer than m of n are missed] for m = 0 ... ``most``, from the worse state before.

        Exact by transfer matrix, O(n most).
        """
        import numpy as np

        worst = np.zeros(most + 1)
        for start in (0, 1):
            counts = np.zeros((2, most + 1))  # counts[state, misses so far]
            counts[start, 0] = 1.0
            for _ in range(n):
                good = (1 - self.to_bad) * counts[0] + self.to_good * counts[1]
                bad = self.to_bad * counts[0] + (1 - self.to_good) * counts[1]
                for state, mass, loss in ((0, good, self.loss_good), (1, bad, self.loss_bad)):
                    counts[state] = (1 - loss) * mass
                    counts[state, 1:] += loss * mass[:-1]
            total = counts.sum(axis=0)
            worst = np.maximum(worst, np.concatenate(([0.0], np.cumsum(total)))[: most + 1])
        return [float(value) for value in worst]

    def quantile(self, n: int, eps: float) -> int:
        """The largest m with P[fewer than m of n are missed] <= eps, from either state before."""
        # it is below the mean, or the mean is below one
        tails = self.tails(n, min(n, int(n * self.mean) + 1))
        return max(m for m, p in enumerate(tails) if p * GUARD <= eps)
