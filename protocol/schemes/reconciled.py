"""`reconciled`: words of coins that the controller estimates, corrected and then shortened.

For a loop whose disturbance is Gaussian: no set tells the candidates apart, so each end has a bit
in every transition, the plant its coin and the controller the likeliest candidate, and some of them
differ. Both gather words of n bits. The cipher symbols of the next n transitions carry

1. n - k bits in clear: the syndrome of the controller's word in a BCH code. With it the plant finds
   the controller's word, where they differ in at most t bits;
2. :data:`CHECK_BITS` bits in clear, a hash of that word. Where the plant has another, or found
   none, its session ends, and the message starts again as after any session;
3. k - :data:`CHECK_BITS` message symbols under as many other bits of the hash: no more than the
   word may still hide from one who knew nothing of it.

The hash is a Toeplitz matrix whose bits are public and fixed, drawn before any word is.
"""

import hashlib
from functools import cache, lru_cache
from typing import ClassVar, Final, NamedTuple

from protocol.agreement import NO_SYMBOL
from protocol.schemes.base import Carry, Scheme, check_verdict
from protocol.schemes.bch import BCH

CHECK_BITS: Final = 8
"""A wrong word passes the check once in 256 times; then the frame's own check refuses it."""

LABEL: Final = b"wyner reconciled 12"
"""The first for which syndrome and hash together are as many independent bits as the word has: one
who knows nothing of a word knows nothing of its keys."""

CLEAR: Final = 1
CARRY: Final = 2

NONE: Final = -1
"""No word is whole yet."""

WRONG: Final = -2
"""At the plant: the word is not the controller's."""


class ReconciledState(NamedTuple):
    """What an end has of two words.

    ``s`` is CARRY where the transition to come carries a message symbol, ``i`` its place in the
    word; ``word`` has the bits gathered so far, ``held`` is the word before, and ``heard`` what
    the plant has heard of its syndrome and check.
    """

    s: int
    i: int
    word: int
    held: int
    heard: int


@cache
def _code(m: int, t: int) -> BCH:
    return BCH(m, t)


@lru_cache(maxsize=64)
def shortened(word: int, n: int, bits: int) -> int:
    """The hash of an n-bit word: row i of the matrix is bits i to i + n - 1 of a fixed stream."""
    stream = int.from_bytes(hashlib.shake_256(LABEL).digest((n + bits) // 8 + 1))
    return sum(((stream >> i & word).bit_count() & 1) << i for i in range(bits))


class Reconciled(Scheme[ReconciledState]):
    """Words of 63 bits, BCH(63, 30): 33 bits of syndrome correct six errors.

    Raises
    ------
    ValueError
        For more than two symbols.
    """

    name: ClassVar[str] = "reconciled"
    version: ClassVar[int] = 1
    corrects: ClassVar[bool] = True
    initial = ReconciledState(CLEAR, 0, 0, NONE, 0)
    m: ClassVar[int] = 6
    t: ClassVar[int] = 6

    def __init__(self, alphabet: int) -> None:
        super().__init__(alphabet)
        if alphabet != 2:
            raise ValueError(f"secrecy.candidates: got {alphabet}, expected 2 for {self.name}")
        self.code = _code(self.m, self.t)
        self.clear_bits = self.code.check_bits + CHECK_BITS
        self.key_bits = self.code.n - self.clear_bits

    def advance(self, state: ReconciledState, verdict: int) -> tuple[ReconciledState, Carry]:
        """Gather the verdict's bit; a missing one is 0, an error as any other."""
        check_verdict(verdict, self.alphabet)
        pad = self.pad(state)
        word = state.word | max(verdict, 0) << state.i
        i, held, heard = state.i + 1, state.held, state.heard
        if i == self.code.n:
            i, word, held, heard = 0, 0, word, 0
        s = CARRY if held != NONE and i >= self.clear_bits else CLEAR
        return ReconciledState(s, i, word, held, heard), Carry(pad, pad)

    def pad(self, state: ReconciledState) -> int:
        """The word's next key bit, in state 2."""
        if state.s != CARRY:
            return NO_SYMBOL
        place = CHECK_BITS + state.i - self.clear_bits
        return self._hash(state.held) >> place & 1 if state.held >= 0 else 0

    def tests(self, state: ReconciledState) -> bool:  # noqa: ARG002
        """In every transition."""
        return True

    def clear(self, state: ReconciledState) -> int:
        """The next bit of the syndrome or of the check."""
        if state.held == NONE or state.s == CARRY:
            return NO_SYMBOL
        return self._shown(state.held) >> state.i & 1

    def hear(self, state: ReconciledState, cipher: int) -> ReconciledState:
        """The last bit in clear corrects the word."""
        if state.held == NONE or state.s == CARRY:
            return state
        heard, held = state.heard | cipher << state.i, state.held
        if state.i == self.clear_bits - 1:
            syndrome = heard & ((1 << self.code.check_bits) - 1)
            errors = self.code.errors(syndrome ^ self.code.syndrome(held))
            held = WRONG if errors is None else held ^ errors
            if held != WRONG and self._shown(held) != heard:
                held = WRONG
        return state._replace(held=held, heard=heard)

    def differs(self, state: ReconciledState) -> bool:
        """Whether the word could not be corrected."""
        return state.held == WRONG

    def _shown(self, word: int) -> int:
        """The bits in clear of a word: its syndrome, then its check."""
        check = self._hash(word) & ((1 << CHECK_BITS) - 1)
        return self.code.syndrome(word) | check << self.code.check_bits

    def _hash(self, word: int) -> int:
        return shortened(word, self.code.n, CHECK_BITS + self.key_bits)


class Reconciled31(Reconciled):
    """Words of 31 bits, BCH(31, 16): 15 bits of syndrome correct three errors."""

    name: ClassVar[str] = "reconciled-31"
    m: ClassVar[int] = 5
    t: ClassVar[int] = 3
