"""A random Toeplitz matrix over bits: what is left when a missed message may be half heard.

The Cauchy matrix works on whole nonces: half of one heard is half of every row known. A Toeplitz
matrix works on bits and needs only that ``h`` of them stayed unknown, wherever they are. It costs a
seed as long as everything it is applied to, public and drawn afresh **after** the block has closed,
and a few dozen bits. It is also an oracle for the Cauchy matrix that shares nothing with it.
"""

import numpy as np
from numpy.typing import NDArray

Bits = NDArray[np.uint8]


def seed_bits(n: int, length: int) -> int:
    """Bits of the seed for ``n`` bits of input and ``length`` of output."""
    return n + length - 1


def toeplitz(bits: Bits, seed: Bits, length: int) -> Bits:
    """T x over GF(2), with T[i, j] = seed[i - j + n - 1].

    Parameters
    ----------
    bits : array of 0 and 1, shape (n,)
    seed : array of 0 and 1, shape (n + length - 1,)
    length : int

    Returns
    -------
    array of 0 and 1, shape (length,)
    """
    n = len(bits)
    if len(seed) != seed_bits(n, length):
        raise ValueError(f"seed: got {len(seed)} bits, expected {seed_bits(n, length)}")
    size = 1 << (len(seed) + n).bit_length()
    # a convolution of zeros and ones: its sums are below 2^17 and exact after rounding
    spectrum = np.fft.rfft(bits, size) * np.fft.rfft(seed, size)
    sums = np.rint(np.fft.irfft(spectrum, size)[n - 1 : n - 1 + length])
    return np.asarray(sums.astype(np.int64) & 1, np.uint8)


def matrix(seed: Bits, n: int, length: int) -> Bits:
    """T itself, shape (length, n)."""
    i, j = np.arange(length)[:, None], np.arange(n)[None, :]
    return np.asarray(seed[i - j + n - 1], np.uint8)
