"""States of many runs' generators at once.

NumPy takes some fifteen microseconds to make ``PCG64(SeedSequence(seed, spawn_key=...))``, as much
as fifty steps of a run take here. This is the same arithmetic over arrays of runs (O'Neill's
seed_seq and PCG64's own start, both of fixed specification); a test holds it to NumPy's.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Words = NDArray[np.uint32]

WORD: Final = 0xFFFFFFFF
LONG: Final = (1 << 128) - 1
POOL: Final = 4
INIT_A, MULT_A = 0x43B0D7E5, 0x931E8875
INIT_B, MULT_B = 0x8B51F9DD, 0x58F38DED
MIX_L, MIX_R = 0xCA01F9DD, 0x4973F715
PCG_MULTIPLIER: Final = 0x2360ED051FC65DA44385DF649FCCF645


class _Hash:
    """Multiply-and-shift hash whose constant changes with every use."""

    def __init__(self, start: int, factor: int) -> None:
        self.constant, self.factor = start, factor

    def __call__(self, value: Words) -> Words:
        value = value ^ np.uint32(self.constant)
        self.constant = self.constant * self.factor & WORD
        out: Words = value * np.uint32(self.constant)
        return out ^ (out >> np.uint32(16))


def _mix(x: Words, y: Words) -> Words:
    value: Words = np.uint32(MIX_L) * x - np.uint32(MIX_R) * y
    return value ^ (value >> np.uint32(16))


def _words(value: int) -> list[int]:
    """The number in 32-bit words, least significant first; at least one."""
    if value < 0:
        raise ValueError(f"seed: got {value}, expected 0 or more")
    out = [value & WORD]
    while value := value >> 32:
        out.append(value & WORD)
    return out


def generator_states(seed: int, runs: Sequence[int], stream: int) -> list[dict[str, Any]]:
    """The state of :func:`protocol.streams.generator` for each run, as NumPy's PCG64 takes it.

    Raises
    ------
    ValueError
        When a run's number does not fit 32 bits.
    """
    if len(runs) and not 0 <= min(runs) <= max(runs) <= WORD:
        raise ValueError(f"runs: got {min(runs)} to {max(runs)}, expected 0 to {WORD}")
    of_seed = _words(seed)
    of_seed += [0] * (POOL - len(of_seed))
    number = np.array(runs, dtype=np.uint32)
    entropy = [np.full_like(number, word) for word in of_seed]
    entropy += [number, *(np.full_like(number, word) for word in _words(stream))]
    mixed = _Hash(INIT_A, MULT_A)
    pool = [mixed(word) for word in entropy[:POOL]]
    for source in range(POOL):
        for target in range(POOL):
            if source != target:
                pool[target] = _mix(pool[target], mixed(pool[source]))
    for word in entropy[POOL:]:
        for target in range(POOL):
            pool[target] = _mix(pool[target], mixed(word))
    out = _Hash(INIT_B, MULT_B)
    words = [out(pool[i % POOL]).astype(np.uint64) for i in range(2 * POOL)]
    halves = [(words[i] | words[i + 1] << np.uint64(32)).tolist() for i in range(0, 8, 2)]
    states = []
    for high, low, sequence_high, sequence_low in zip(*halves, strict=True):
        increment = ((sequence_high << 64 | sequence_low) << 1 | 1) & LONG
        start = increment + (high << 64 | low)
        state = (start * PCG_MULTIPLIER + increment) & LONG
        states.append(
            {
                "bit_generator": "PCG64",
                "state": {"state": state, "inc": increment},
                "has_uint32": 0,
                "uinteger": 0,
            }
        )
    return states
