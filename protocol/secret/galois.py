"""GF(2^16) in NumPy: addition is exclusive or, multiplication goes through logarithms.

The polynomial is x^16 + x^12 + x^3 + x + 1 (0x1100B); x is a generator. The logarithm of 0 points
behind both periods of the table of powers, where all entries are 0, so no product needs a branch.
"""

from functools import cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Words = NDArray[np.uint16]

POLYNOMIAL: Final = 0x1100B
ORDER: Final = 65535
"""Order of the multiplicative group."""

_ZERO: Final = 2 * ORDER


class Tables(NamedTuple):
    """``exp``: two periods of the generator's powers, then zeros. ``log``: the logarithms."""

    exp: Words
    log: NDArray[np.intp]


@cache
def tables() -> Tables:
    """The field's tables, computed once."""
    powers = np.empty(ORDER, np.uint16)
    value = 1
    for i in range(ORDER):
        powers[i] = value
        value <<= 1
        if value > ORDER:
            value ^= POLYNOMIAL
    exp = np.zeros(2 * _ZERO + 1, np.uint16)
    exp[:ORDER] = exp[ORDER:_ZERO] = powers
    log = np.full(ORDER + 1, _ZERO, np.intp)
    log[powers] = np.arange(ORDER)
    return Tables(exp, log)


def multiply(a: Words, b: Words) -> Words:
    """Products, element by element; shapes broadcast as in NumPy."""
    exp, log = tables()
    out: Words = exp[log[a] + log[b]]
    return out


def inverse(a: Words) -> Words:
    """Inverses, element by element; no element may be 0."""
    exp, log = tables()
    return exp[ORDER - log[a]]


def product(a: Words, b: Words) -> Words:
    """The matrix product of shapes (r, c) and (c, w), shape (r, w)."""
    exp, log = tables()
    log_a, log_b = log[a].T.copy(), log[b]
    out = np.zeros((a.shape[0], b.shape[1]), np.uint16)
    chunk = max(1, 1 << 15 >> out.size.bit_length())
    for j in range(0, len(log_b), chunk):
        logs = log_a[j : j + chunk, :, None] + log_b[j : j + chunk, None, :]
        powers = exp.take(logs, mode="wrap")  # none is beyond the end: it spares the check
        out ^= np.bitwise_xor.reduce(powers, axis=0)
    return out
