"""The field, and the Cauchy matrix over it."""

import random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.secret.extractor import cauchy, extract, words
from protocol.secret.galois import (
    ORDER,
    POLYNOMIAL,
    inverse,
    multiply,
    product,
    tables,
)
from tests.support.known_rows import eliminate, without

ELEMENT = st.integers(0, ORDER)


def school(a: int, b: int) -> int:
    """Multiplication of polynomials by shifting, and the remainder: no table."""
    total = 0
    while b:
        if b & 1:
            total ^= a
        a, b = a << 1, b >> 1
        if a > ORDER:
            a ^= POLYNOMIAL
    return total


@given(ELEMENT, ELEMENT)
def test_products_are_those_of_polynomials(a: int, b: int) -> None:
    assert int(multiply(np.uint16(a), np.uint16(b))) == school(a, b)  # type: ignore[arg-type]


def test_x_generates_the_field() -> None:
    assert len(set(tables().exp[:ORDER].tolist())) == ORDER
    everything = np.arange(1, ORDER + 1, dtype=np.uint16)
    assert (multiply(everything, inverse(everything)) == 1).all()


@given(st.integers(1, 40), st.integers(0, 2**32))
def test_every_square_part_of_the_matrix_can_be_inverted(size: int, seed: int) -> None:
    chosen = random.Random(seed)
    G = cauchy(60, 400)
    part = G[np.ix_(chosen.sample(range(60), size), chosen.sample(range(400), size))]
    assert eliminate(part)[1] == size


def test_the_matrix_ends_where_the_field_does() -> None:
    assert cauchy(2, 65534).shape == (2, 65534)
    with pytest.raises(ValueError, match=r"^rows \+ columns: got 3 \+ 65534"):
        cauchy(3, 65534)


def test_rows_depend_on_every_nonce_and_never_outnumber_them() -> None:
    generator = random.Random(2)
    nonces = [generator.randbytes(32) for _ in range(12)]
    rows = extract(nonces, 4)
    assert len(rows) == 4
    assert all(len(row) == 32 for row in rows)
    for place in range(12):
        changed = list(nonces)
        changed[place] = generator.randbytes(32)
        assert all(a != b for a, b in zip(rows, extract(changed, 4), strict=True))
    with pytest.raises(ValueError, match=r"^rows: got 13, expected at most the 12 nonces"):
        extract(nonces, 13)


@pytest.mark.parametrize("unheard", [16, 64, 128, 240])
def test_by_words_she_knows_nothing_of_what_the_bound_allows_and_one_row_more_is_known(
    unheard: int,
) -> None:
    """She chooses which words of which nonces: prefixes, single words, whole nonces."""
    generator = random.Random(unheard)
    n, missed = 40, 16
    rows = missed * unheard // 256
    per = unheard // 16
    nonces = [generator.randbytes(32) for _ in range(n)]
    keys = words(extract(nonces, rows + 1, True)).reshape(-1, 1)
    choices = (
        [16 * j + 16 - per + i for j in range(missed) for i in range(per)],  # heads of frames
        generator.sample(range(16 * n), missed * per),  # words anywhere
        sorted(generator.sample(range(16 * n), missed * per))[::-1],
    )
    for gone in choices:
        G = cauchy(16 * (rows + 1), 16 * n)
        assert eliminate(G[: 16 * rows, gone])[1] == 16 * rows  # nothing of the proper length
        combinations = without(G, gone)
        assert len(combinations) == 16 * (rows + 1) - len(gone)
        heard = np.setdiff1d(np.arange(16 * n), gone)
        known = product(G[:, heard], words(nonces).reshape(-1, 1)[heard])
        assert (product(combinations, known) == product(combinations, keys)).all()


def test_slices_of_the_work_make_the_same_rows() -> None:
    generator = random.Random(6)
    nonces = [generator.randbytes(32) for _ in range(300)]
    for by_words in (False, True):
        rows = extract(nonces, 60, by_words)
        x = words(nonces).reshape(-1, 1) if by_words else words(nonces)
        whole = product(cauchy(60 * 16 // x.shape[1], len(x)), x).reshape(60, 16)
        assert rows == [row.tobytes() for row in whole.astype(">u2")]


def test_words_are_big_endian() -> None:
    assert words([b"\x01\x02\x03\x04"]).tolist() == [[0x0102, 0x0304]]
    assert words([]).shape == (0, 16)
