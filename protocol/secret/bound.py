"""The least number of copies that the tap misses, and how many rows of key that leaves.

For N = 256 transitions with two copies each, eps_E = 0.3 and eps_sec = 1e-12 the tap misses at
least Q = 85 of 512. Each copy that was sent but not counted takes one row away.

Tails are summed from logarithms of factorials, without a library, so both ends come to the same
number. A relative guard of 1e-9 covers the rounding on the safe side.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Literal

from protocol.secret.nonces import NONCE_BYTES

GUARD: Final = 1 + 1e-9
"""Factor on a computed tail before it is compared: rounding must never gain a row."""

NONCE_BITS: Final = 8 * NONCE_BYTES
"""Bits of the nonce in each copy, and of a row of a block."""

Directions = Literal["both", "offers", "measurements"]

_COUNTED: Final[dict[Directions, int]] = {"both": 3, "offers": 1, "measurements": 2}
"""Whose copies may count: 1 the offer's, 2 the measurement's, 3 both."""


def _term(n: int, e: float, k: int) -> float:
    """P[Bin(n, e) = k], to some 1e-11, relative."""
    choices = math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)
    return math.exp(choices + k * math.log(e) + (n - k) * math.log1p(-e))


@lru_cache(maxsize=256)  # the blocks of a session are alike
def quantile(n: int, e: float, eps: float) -> int:
    """Q(n, e, eps) = max { m : P[Bin(n, e) < m] <= eps }, exact tails.

    Parameters
    ----------
    n : int
        Number of copies.
    e : float
        Least probability that a copy is missed, given all before it.
    eps : float
        Probability that the bound may fail.

    Returns
    -------
    int
        Copies that are missed at least, except with probability ``eps``.

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
    """What the operator claims that every tap misses, and how far a key may be from perfect.

    Parameters
    ----------
    eps_E : float
        Least probability, given everything that happened before, that the tap misses the next
        copy 0 entirely. 0 claims nothing, and makes no key.
    eps_sec : float
        Distance from a perfect key that a block may have, in total variation.
    directions : {"both", "offers", "measurements"}
        Directions in which the tap misses copies. Nonces of the other one do not count.
    unheard_bits : int
        Bits of a missed copy's nonce that stay unheard, in whole words of 16. Below 256 Eve may
        hear a part of a message.
    appearances : int
        How often a copy 0 leaves an end at most. ``eps_E`` is claimed of each appearance, given
        all before it, so a copy is missed with probability eps_E^appearances at least.
    """

    eps_E: float
    eps_sec: float = 1e-12
    directions: Directions = "both"
    unheard_bits: int = NONCE_BITS
    appearances: int = 1

    @property
    def eps_copy(self) -> float:
        """Least probability that Eve misses all appearances of a copy 0."""
        return self.eps_E**self.appearances

    @property
    def by_words(self) -> bool:
        """Whether keys are made of words of 16 bits, since Eve may hear a part of a nonce."""
        return self.unheard_bits < NONCE_BITS

    @property
    def copies(self) -> int:
        """Copies 0 of a step that may count: 2, or 1 where one direction is left out."""
        return 2 if self.directions == "both" else 1

    def counting(self, counts: int) -> int:
        """Those of the copies taken that may count: 1 the offer's, 2 the measurement's, 3 both."""
        return counts & _COUNTED[self.directions]

    def misses(self, n: int) -> int:
        """Copies of ``n`` that Eve misses at least, except with probability eps_sec."""
        if self.eps_E == 0:
            return 0
        return quantile(n, self.eps_copy, self.eps_sec)

    def rows(self, transitions: int, steps: int, counted: int) -> int:
        """Rows R of a block. Below 2 it makes no key.

        Parameters
        ----------
        transitions : int
            N, transitions of the block.
        steps : int
            Steps from the block before to this one's last transition, missed ones included.
        counted : int
            C, the copies 0 that count.
        """
        lost = self.copies * steps - counted
        missed = max(0, self.misses(self.copies * transitions) - lost)
        return missed * self.unheard_bits // NONCE_BITS

    def sentence(self) -> str:
        """The claim as one sentence; it is printed with every key."""
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
    """Least number in 1 ... ``most`` for which ``holds``; None where there is none.

    ``holds`` must stay true once it is true.
    """
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
