"""Halves of messages are put together exactly where the whole one's check is what was heard."""

import zlib

import numpy as np

from protocol.schemes.framing import CHECK_BYTES, LENGTH_BYTES
from tap_service.inference.message_graph import Halves, join

FIRST = (b"the mill", b"the hill", b"the bill", b"the well")
SECOND = (b" at nine", b" at five", b" at noon")


def _symbols(check: int, size: int) -> list[int]:
    bits = size.bit_length() - 1
    count = 8 * CHECK_BYTES // bits
    return [check >> bits * (count - 1 - j) & (size - 1) for j in range(count)]


def _halves(texts: tuple[bytes, ...], middle: list[int]) -> Halves:
    rows = np.array([list(text) for text in texts], dtype=np.uint8)
    return Halves(rows, -np.arange(len(texts), dtype=float), np.array(middle))


def _whole(first: Halves, second: Halves, a: int, b: int) -> bytes:
    return bytes(first.texts[a]) + bytes(second.texts[b])


def test_the_check_picks_the_one_pair() -> None:
    first, second = _halves(FIRST, [0, 0, 1, 1]), _halves(SECOND, [0, 0, 1])
    for size in (2, 4, 16):
        text = b"the hill at five"
        body = len(text).to_bytes(LENGTH_BYTES, "big") + text
        heard = np.eye(size)[_symbols(zlib.crc32(body), size)]
        heard[3] = 1 / size  # one was missed
        a, b, mass = join(first, second, heard)
        assert [_whole(first, second, i, j) for i, j in zip(a, b, strict=True)] == [text]
        # a half goes on with those of its own number alone
        every = [0.0 - 0, 0.0 - 1, -1.0 - 0, -1.0 - 1, -2.0 - 2, -3.0 - 2]
        assert abs(mass - np.logaddexp.reduce(every)) < 1e-9


def test_without_a_check_all_pairs_are_given_by_weight() -> None:
    first, second = _halves(FIRST, [0, 0, 1, 1]), _halves(SECOND, [0, 0, 1])
    a, b, _ = join(first, second, np.full((16, 4), 0.25))
    assert len(a) == 6
    score = first.scores[a] + second.scores[b]
    assert (np.diff(score) <= 0).all()


def test_halves_are_told_apart_by_text_and_number() -> None:
    halves = _halves((*FIRST, FIRST[0], FIRST[0]), [1, 1, 0, 0, 1, 0])
    distinct, rows = halves.distinct()
    assert len(rows) == 5
    assert list(distinct.middle) == [0, 0, 0, 1, 1]
    assert list(distinct.rank()) == [0, 1, 2, 0, 1]
