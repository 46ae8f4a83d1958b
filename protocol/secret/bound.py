"""How many copies the tap misses at least, and how many rows of key that leaves.

For N = 256 transitions with two copies each, eps_E = 0.3 and eps_sec = 1e-12 the tap misses at
least Q = 85 of 512, and each copy that was sent but not counted takes one row away.

Tails are summed from logarithms of factorials, so both ends need no library for it and come to the
same number; a guard of 1e-9, relative, covers their rounding on the safe side.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal

from protocol.secret.nonces import NONCE_BYTES

GUARD: Final = 1 + 1e-9
"""Factor on a computed tail before it is compared: rounding must never gain a row."""

NONCE_BITS: Final = 8 * NONCE_BYTES
"""Of the nonce in each copy; a row of a block is as long."""

Directions = Literal["both", "offers", "measurements"]


def _term(n: int, e: float, k: int) -> float:
    """P[Bin(n, e) = k], to some 1e-11, relative."""
    choices = math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)
    return math.exp(choices + k * math.log(e) + (n - k) * math.log1p(-e))


def quantile(n: int, e: float, eps: float) -> int:
    """Q(n, e, eps) = max { m : P[Bin(n, e) < m] <= eps }, exact tails.

    Parameters
    ----------
    n : int
        Copies.
    e : float
        Least probability that one is missed, given all before it.
    eps : float
        Probability with which fewer may be missed.

    Raises
    ------
    ValueError
        When ``e`` is not in [0, 1] or ``eps`` not in (0, 1).
    """
    _check("e", e, 0 <= e <= 1, "0 to 1")
    _check("eps", eps, 0 < eps < 1, "between 0 and 1")
    if e == 1:
        return n
    if e == 0:
        return 0
    total, m = 0.0, 0
    while m < n:
        total += _term(n, e, m)
        if total * GUARD > eps:
            break
        m += 1
    return m


def _check(name: str, value: float, holds: bool, expected: str) -> None:
    if not holds:
        raise ValueError(f"{name}: got {value:g}, expected {expected}")


@dataclass(frozen=True, slots=True)
class Assumption:
    """What the operator claims of every tap, and the chance that the claim may leave.

    Parameters
    ----------
    eps_E : float
        Least probability, given everything that happened before, that the tap misses the next
        copy 0 entirely. 0 claims nothing, and makes no key.
    eps_sec : float
        Distance from a perfect key that a block may have.
    directions : {"both", "offers", "measurements"}
        In which directions the tap misses; the other one's nonces are left out.
    unheard_bits : int
        Of the nonce in a copy that she misses, the bits that stay unheard, in whole words of 16:
        all 256, unless she may hear a part of a message.
    appearances : int
        How often a copy 0 leaves an end at most. Each time is a chance for her, so that eps_E is
        claimed of each appearance, given all before it, and a copy is missed with eps_E to that
        power at least.
    """

    eps_E: float
    eps_sec: float = 1e-12
    directions: Directions = "both"
    unheard_bits: int = NONCE_BITS
    appearances: int = 1

    @property
    def eps_copy(self) -> float:
        """Least probability that she misses a copy 0 in all of its appearances."""
        return self.eps_E**self.appearances

    @property
    def by_words(self) -> bool:
        """Whether keys are made of the nonces' words, since she may hear a part of one."""
        return self.unheard_bits < NONCE_BITS

    @property
    def copies(self) -> int:
        """Copies of a step that count: 2, or 1 where one direction is left out."""
        return 2 if self.directions == "both" else 1

    def counting(self, counts: int) -> int:
        """Of copies that were taken (1 the offer's, 2 the measurement's) those that may count."""
        return counts & {"both": 3, "offers": 1, "measurements": 2}[self.directions]

    def misses(self, n: int) -> int:
        """How many of ``n`` copies she misses at least, but for eps_sec."""
        if self.eps_E == 0:
            return 0
        return quantile(n, self.eps_copy, self.eps_sec)

    def rows(self, transitions: int, steps: int, counted: int) -> int:
        """Rows R that a block may have; below 2 it makes no key.

        Parameters
        ----------
        transitions : int
            N, transitions of the block.
        steps : int
            K, steps from the block before to this one's last transition, missed ones included.
        counted : int
            C, copies counted.
        """
        lost = self.copies * steps - counted
        missed = max(0, self.misses(self.copies * transitions) - lost)
        return missed * self.unheard_bits // NONCE_BITS

    def sentence(self) -> str:
        """The claim in words, as it is printed with every key."""
        where = {
            "both": "first copies",
            "offers": "offers' first copies",
            "measurements": "measurements' first copies",
        }[self.directions]
        if not self.eps_E:
            return "nothing is claimed that a tap misses (eps_E = 0): no secret"
        share = f"{100 * self.eps_E:.4g} % of {where}"
        if self.appearances > 1:
            share = f"{100 * self.eps_E:.4g} % of the {self.appearances} appearances of {where}"
        beside = ""
        if self.by_words:
            beside = f", and then {self.unheard_bits} bits of the nonce at least"
        return f"secret only from a tap that misses {share} or more{beside}"


def least(holds: Callable[[int], bool], most: int) -> int | None:
    """The least number in 1 ... ``most`` for which ``holds``, a test that stays true once true."""
    if not holds(most):
        return None
    low, high = 0, most
    while high - low > 1:
        middle = (low + high) // 2
        if holds(middle):
            high = middle
        else:
            low = middle
    return high


def clopper_pearson(k: int, n: int, alpha: float) -> tuple[float, float]:
    """One-sided bounds on a probability of which ``k`` of ``n`` trials came true.

    Parameters
    ----------
    k, n : int
    alpha : float
        Probability that one of the two bounds does not hold; 1e-6 is usual here.

    Returns
    -------
    tuple of float
        Lower and upper bound (Clopper and Pearson 1934).
    """
    from scipy.special import betaincinv

    lower = 0.0 if k == 0 else float(betaincinv(k, n - k + 1, alpha))
    upper = 1.0 if k == n else float(betaincinv(k + 1, n - k, 1 - alpha))
    return lower, upper
