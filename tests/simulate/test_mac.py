"""One-time tags: the field is one, and no forger passes more often than is stated."""

import itertools
from collections import Counter

import numpy as np
import pytest

from studies.attacks.defences import TAGS, Field, Mac, forging, tag_of

SMALL = Field(4, 0b10011)
"""x^4 + x + 1."""


def test_the_small_field_is_a_field() -> None:
    for a in range(1, 16):
        assert sorted(SMALL.multiply(a, b) for b in range(16)) == list(range(16))
    for a, b, c in itertools.product(range(16), repeat=3):
        assert SMALL.multiply(a, b ^ c) == SMALL.multiply(a, b) ^ SMALL.multiply(a, c)
        assert SMALL.multiply(SMALL.multiply(a, b), c) == SMALL.multiply(a, SMALL.multiply(b, c))


def test_the_large_polynomial_is_irreducible() -> None:
    """Rabin: x^(2^32) = x, and no common factor with x^(2^16) - x, 2 the only prime of 32."""

    def remainder(a: int, b: int) -> int:
        while a.bit_length() >= b.bit_length():
            a ^= b << (a.bit_length() - b.bit_length())
        return a

    powers = [2]
    for _ in range(32):
        powers.append(TAGS.multiply(powers[-1], powers[-1]))
    assert powers[32] == 2
    a, b = TAGS.polynomial, powers[16] ^ 2
    while b:
        a, b = b, remainder(a, b)
    assert a == 1


def test_no_forger_of_the_small_field_does_better_than_is_stated() -> None:
    """Every pair of messages of up to two words, every shift of the tag, all 16 points counted.

    The pad is uniform and used once, so a forger who saw a message with its tag succeeds when the
    hashes differ by her shift: for the points that are counted here.
    """
    texts = [list(t) for w in range(3) for t in itertools.product(range(16), repeat=w)]
    values = {tuple(t): [SMALL.hashed(z, t) for z in range(16)] for t in texts}
    worst = 0
    for one, other in itertools.combinations(values, 2):
        shifts = Counter(a ^ b for a, b in zip(values[one], values[other], strict=True))
        most = max(shifts.values())
        words = max(len(one), len(other))
        assert most / 16 <= forging(words, SMALL), (one, other)
        worst = max(worst, most)
    assert worst == 3  # the bound is attained


def test_the_pad_hides_the_hash() -> None:
    """Each tag is as likely as any other, whatever the message and the point."""
    for z, text in itertools.product(range(16), ([], [5], [5, 9])):
        assert sorted(SMALL.hashed(z, text) ^ pad for pad in range(16)) == list(range(16))


def test_numbers_and_arrays_have_the_same_tags() -> None:
    draw = np.random.default_rng(7)
    words = draw.integers(1 << 32, size=(40, 6), dtype=np.uint32)
    point = draw.integers(1 << 32, size=40, dtype=np.uint32)
    pad = draw.integers(1 << 32, size=40, dtype=np.uint32)
    tags = tag_of(point, pad, words)
    for i in range(40):
        assert TAGS.hashed(int(point[i]), words[i].tolist()) ^ int(pad[i]) == int(tags[i])


def test_a_message_with_its_tag_passes_and_no_other() -> None:
    mac, draw = Mac(2, 4), np.random.default_rng(7)
    session, step = mac.session_key(draw, (2000,)), mac.step_key(draw, (2000,))
    x = draw.normal(size=(2000, 2))
    wire = mac.encode(7, session, step, x)
    assert not mac.decode(7, session, step, wire).alarm.any()
    assert mac.decode(8, session, step, wire).alarm.all()  # replayed in another step
    changed = type(wire)(x + 1e-12, wire.tag)
    assert mac.decode(7, session, step, changed).alarm.all()
    other = mac.step_key(draw, (2000,))
    assert mac.decode(7, session, other, wire).alarm.all()


def test_the_key_that_it_costs_and_what_a_try_is_worth() -> None:
    assert Mac(2, 4).key_bits == 64
    assert forging(6) == pytest.approx(1.63e-9, rel=0.01)
