"""Keys that are functions of the applied inputs, over blocks of steps: what bounds them, and codes.

Inputs are counted in half-lengths of D_c along the input, so that d takes all of [-1, 1] in every
step. A *code* is a set of points of R^T for each key, fixed in advance: the plant draws a key and a
point of it, and applies its coordinates one after the other. Every block agrees when points of
different keys are more than 2 apart in some coordinate, and every key has a point within alpha, in
every coordinate, of wherever d leads.

The theorems are those of docs/findings.md; all bits here are claimed by the paper's rule.

Theorem 5, in T steps of m inputs at most alpha^(mT) keys: let K be D_c cut by the inputs' space, T
times over, P_j the points of key j, and R the union of all P_j + K. These are disjoint, and each
P_j + alpha K holds R. Of q keys the smallest has vol(P_j + K) <= vol R / q, so
vol R <= vol(P_j + alpha K) <= alpha^(mT) vol(P_j + K) <= alpha^(mT) vol R / q. The step in the
middle is a lemma: vol(P + alpha K) <= alpha^n vol(P + K) for K convex in n dimensions. Give every
point to its nearest p in K's gauge; the map from x to p + (x - p) / alpha stays within p's part and
shrinks by alpha^n.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import Final

JUST_ABOVE: Final = 1e-9
"""An alpha this much, relatively, above an integer root is taken for above it."""


def most_keys(alpha: float, steps: int, inputs: int = 1) -> int:
    """No code has more keys at ``alpha``, nor just above it: alpha^(m T), theorem 5.

    Parameters
    ----------
    alpha : float
        D_e = alpha D_c.
    steps : int
        T.
    inputs : int
        m.
    """
    return max(1, math.floor(math.pow(alpha, inputs * steps) * (1 + JUST_ABOVE)))


def chained_keys(alpha: float | Fraction, steps: int) -> list[int]:
    """K_1, ..., K_T of the chained code: K_T = ceil(alpha K_(T-1)) - 1 from K_0 = 1.

    Whole numbers throughout, for K grows beyond what a float holds exactly.
    """
    exact = Fraction(alpha)
    out, keys = [], 1
    for _ in range(steps):
        keys = max(1, math.ceil(exact * keys) - 1)
        out.append(keys)
    return out


def chained_bits(alpha: float | Fraction, steps: int) -> float:
    """Bits a step of the chained code over T steps; log2 alpha in the limit, from alpha > 2 on."""
    return math.log2(chained_keys(alpha, steps)[-1]) / steps


def finite_keys(alpha: float, steps: int) -> int:
    """The most keys of finite offers of which every block agrees, at the ends too: theorem 7."""
    one: int = max(1, math.ceil((alpha - 1) / 2))
    return int(one**steps)


@dataclass(frozen=True)
class ChainedCode:
    """The code that chains its steps: the key so far says which inputs the next step may apply.

    In step t the offer is a long progression of spacing ``gap`` / K_(t-1). Of it the plant applies
    one whose index is the key so far, modulo K_(t-1): those are ``gap`` apart, and the defender,
    who has the key so far, tells them. The index modulo K_t is the new key. She, for whom every key
    so far is possible, finds alpha K_(t-1) neighbouring indices possible: enough for every new key.

    Parameters
    ----------
    alpha : Fraction
    gap : Fraction
        Above 2, and so little that K_t neighbours fit in a length of 2 alpha.
    keys : tuple of int
        K_0, ..., K_T.
    """

    alpha: Fraction
    gap: Fraction
    keys: tuple[int, ...]

    @classmethod
    def of(cls, alpha: float | Fraction, steps: int) -> "ChainedCode":
        """The code over ``steps`` steps."""
        exact = Fraction(alpha)
        keys = (1, *chained_keys(exact, steps))
        # K_t neighbours are in every closed window of 2 alpha when K_t spacings fit in it.
        room = min(2 * exact * before / after for before, after in pairwise(keys))
        return cls(exact, 2 + min((room - 2) / 2, Fraction(1, 1000)), keys)

    @property
    def steps(self) -> int:
        """T."""
        return len(self.keys) - 1

    def place(self, t: int, index: int) -> Fraction:
        """Where input ``index`` of step t (from 1) stands, in half-lengths of D_c."""
        return self.gap * index / self.keys[t - 1]

    def within(self, t: int, y: Fraction, reach: Fraction) -> range:
        """Indices of step t within ``reach`` of y."""
        spacing = self.gap / self.keys[t - 1]
        return range(math.ceil((y - reach) / spacing), math.floor((y + reach) / spacing) + 1)

    def possible(self, y: tuple[Fraction, ...], reach: Fraction) -> list[dict[int, int]]:
        """For each step the keys that remain possible, and of each the paths that lead to it.

        Parameters
        ----------
        y : tuple of Fraction
            What was seen: the applied input plus d, of each step.
        reach : Fraction
            1 for the defender, alpha for her.
        """
        out = []
        reached = {0: 1}
        for t, at in enumerate(y, start=1):
            before, after = self.keys[t - 1], self.keys[t]
            following: dict[int, int] = {}
            for index in self.within(t, at, reach):
                paths = reached.get(index % before, 0)
                if paths:
                    following[index % after] = following.get(index % after, 0) + paths
            reached = following
            out.append(reached)
        return out

    def paths(self, length: int) -> Iterator[tuple[tuple[int, ...], int]]:
        """Every path of indices in range(``length`` K_(t-1)) of each step, with its key."""

        def go(t: int, key: int, path: tuple[int, ...]) -> Iterator[tuple[tuple[int, ...], int]]:
            if t > self.steps:
                yield path, key
                return
            before = self.keys[t - 1]
            for index in range(key, length * before, before):
                yield from go(t + 1, index % self.keys[t], (*path, index))

        yield from go(1, 0, ())
