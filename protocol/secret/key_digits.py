"""Digits of keys, and the keyed coin: the plant's choice is a digit that both ends hold.

Without a key the choice is the plant's own, and the controller can only ask whether *some*
candidate explains x(k+1). With one it knows which candidate must, and asks for that one.
Predictions are packed, so that one x(k+1) is within D_c of one of them at most. A spoofer that does
not know the digit passes with probability 1/M, and with M^-n over n steps. If the digit is not
secret it passes always. An honest step never fails.

A digit belongs to an offer, which names its position in the key stream
(:mod:`protocol.secret.stream`). A repeated offer names the same digit, and a later one a later
digit, also where the step was missed or interrupted. Counting transitions instead would save those
digits, and show one twice: a device that dies within a step has applied it, and no transition
counts it.

Once x(k+1) is out, the digit is public: everybody sees which candidate explains it.
"""

import struct
from functools import lru_cache
from typing import Final

WORD_BITS: Final = 32
"""A key is read in words of so many bits, big-endian."""

KEY_BYTES: Final = 32
KEY_BITS: Final = 8 * KEY_BYTES


@lru_cache(maxsize=64)
def digits_per_word(size: int) -> tuple[int, int]:
    """Digits that a word gives, and how many of its values give any.

    A word below the largest multiple of M^t gives t digits, and none above it. t is the one that
    gives the most in the mean: 16 of M = 4 and no word without, 18 of M = 3 and 0.8 % without.
    """
    if not 2 <= size <= 1 << WORD_BITS:
        raise ValueError(f"size: got {size}, expected 2 to {1 << WORD_BITS}")
    best, most = (1, size), 0
    digits, power = 0, size
    while power <= 1 << WORD_BITS:
        digits += 1
        values = (1 << WORD_BITS) // power * power
        if digits * values > most:
            best, most = (digits, values), digits * values
        power *= size
    return best


def digits(key: bytes, size: int) -> tuple[int, ...]:
    """Base-M digits of a key, M = ``size``: uniform and independent, exactly.

    A word is thrown away where keeping it would favour some digits, so the number of digits varies
    with the key: 128 of M = 4 always, 144 of M = 3 at most. M that is a power of two throws none
    away.

    Parameters
    ----------
    key : bytes, 32 of them
        Uniform bits.
    size : int
        M, 2 at the least.

    Raises
    ------
    ValueError
        When the key has another length, or ``size`` is below 2.
    """
    if len(key) != KEY_BYTES:
        raise ValueError(f"key: got {len(key)} bytes, expected {KEY_BYTES}")
    count, values = digits_per_word(size)
    out = []
    for at in range(0, len(key), WORD_BITS // 8):
        word = int.from_bytes(key[at : at + WORD_BITS // 8])
        if word < values:
            for _ in range(count):
                word, digit = divmod(word, size)
                out.append(digit)
    return tuple(out)


def number_of_digits(keys: bytes, size: int) -> int:
    """How many digits these keys give, which stand one behind the other."""
    count, values = digits_per_word(size)
    words = len(keys) * 8 // WORD_BITS
    if values == 1 << WORD_BITS:
        return count * words
    unpacked: tuple[int, ...] = struct.unpack(f">{words}I", keys)
    return count * sum(word < values for word in unpacked)
