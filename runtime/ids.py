"""Random ids, and fingerprints as words."""

import os
from typing import Final


def new_id() -> str:
    """A random id of 64 bits, as 16 hexadecimal digits."""
    return os.urandom(8).hex()


_CONSONANTS: Final = "bdfghjklmnprstvz"
_VOWELS: Final = "aiou"


def proquint(fingerprint: str, words: int = 4) -> str:
    """The first ``words`` 16-bit groups of a hexadecimal fingerprint as words a person can compare.

    The encoding is that of proquints (Wilkerson, arXiv:0901.4016): consonant and vowel in turn.
    """
    groups = []
    for i in range(words):
        value = int(fingerprint[4 * i : 4 * i + 4], 16)
        groups.append(
            _CONSONANTS[value >> 12]
            + _VOWELS[value >> 10 & 3]
            + _CONSONANTS[value >> 6 & 15]
            + _VOWELS[value >> 4 & 3]
            + _CONSONANTS[value & 15]
        )
    return "-".join(groups)
