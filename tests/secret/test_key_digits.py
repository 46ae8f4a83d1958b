"""The digits of a key are uniform exactly, and what a keyed coin is tested by."""

import itertools
import secrets

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.agreement import INSIDE, fails
from protocol.secret.key_digits import WORD_BITS, digits, digits_per_word

SIZES = st.integers(2, 256)
KEYS = st.binary(min_size=32, max_size=32)


@given(SIZES)
def test_the_values_of_a_word_that_are_kept_are_whole_multiples(size: int) -> None:
    """So that every sequence of t digits has as many words as every other."""
    count, values = digits_per_word(size)
    assert values % size**count == 0
    assert 0 < values <= 1 << WORD_BITS


@pytest.mark.parametrize("size", [2, 4, 16, 256])
def test_a_power_of_two_throws_nothing_away(size: int) -> None:
    count, values = digits_per_word(size)
    assert values == 1 << WORD_BITS
    assert count * (size.bit_length() - 1) == WORD_BITS
    key = secrets.token_bytes(32)
    found = digits(key, size)
    whole = 0
    for start in range(0, len(found), count):
        for digit in reversed(found[start : start + count]):
            whole = whole * size + digit
    assert whole == int.from_bytes(key)


@given(SIZES, KEYS)
def test_a_key_gives_so_many_digits_for_each_word_that_is_kept(size: int, key: bytes) -> None:
    count, values = digits_per_word(size)
    words = [int.from_bytes(key[at : at + 4]) for at in range(0, 32, 4)]
    found = digits(key, size)
    assert len(found) == count * sum(word < values for word in words)
    assert all(0 <= digit < size for digit in found)


def test_every_pair_of_digits_comes_as_often_as_every_other() -> None:
    """Of the words that one multiple of 3^2 apart begin, each pair of digits comes once."""
    count, values = digits_per_word(3)
    assert count == 18
    assert values == 11 * 3**18
    for start in (0, values - 9):
        found = set()
        for word in range(start, start + 9):
            found.add(digits(word.to_bytes(4) * 8, 3)[:2])
        assert found == set(itertools.product(range(3), repeat=2))
    assert digits(values.to_bytes(4) * 8, 3) == ()


def test_the_test_is_the_agreements_own() -> None:
    assert not fails((0.3, 2.0), 0)
    assert fails((0.3, 2.0), 1)
    assert not fails((INSIDE, 2.0), 0)
    assert fails((float("nan"), 2.0), 0)


def test_bad_input_is_one_line() -> None:
    with pytest.raises(ValueError, match="key: got 31 bytes, expected 32"):
        digits(bytes(31), 2)
    with pytest.raises(ValueError, match="size: got 1, expected 2 to"):
        digits(bytes(32), 1)
