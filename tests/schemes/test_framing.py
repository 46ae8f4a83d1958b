"""Framing: what goes in comes out, damage is refused, a restart loses nothing."""

import math
import random
import zlib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.schemes.framing import (
    IDLE,
    MAX_PAYLOAD,
    Deframer,
    block_bytes,
    digits_of,
    encode_frame,
    frame_length,
)

sizes = st.one_of(st.integers(2, 16), st.integers(17, 256))
payloads = st.binary(max_size=40)


def push_all(deframer: Deframer, symbols: bytes) -> list[bytes]:
    return [payload for s in symbols if (payload := deframer.push(s)) is not None]


@given(sizes, st.lists(payloads, max_size=4), st.lists(st.integers(0, 20), min_size=5, max_size=5))
def test_messages_come_out_as_they_went_in(size: int, sent: list[bytes], gaps: list[int]) -> None:
    stream = b"".join(
        bytes([IDLE]) * gap + encode_frame(payload, size)
        for gap, payload in zip(gaps, sent, strict=False)
    )
    deframer = Deframer(size)
    assert push_all(deframer, stream) == sent
    assert not deframer.symbols


@given(sizes, payloads)
def test_a_frame_is_as_long_as_it_says(size: int, payload: bytes) -> None:
    symbols = encode_frame(payload, size)
    assert len(symbols) == frame_length(len(payload), size)
    assert max(symbols) < size
    deframer = Deframer(size)
    lengths = set()
    for s in symbols[:-1]:
        assert deframer.push(s) is None
        lengths.add(deframer.expected_length)
    assert lengths == {0, len(symbols)}


@pytest.mark.parametrize(
    ("size", "count", "digits"),
    [
        (2, 1, 8), (3, 11, 56), (4, 1, 4), (5, 11, 38), (6, 8, 25), (7, 7, 20), (8, 3, 8),
        (9, 11, 28), (10, 7, 17), (12, 4, 9), (15, 15, 31), (16, 1, 2), (25, 11, 19), (256, 1, 1),
    ],
)  # fmt: skip
def test_blocks(size: int, count: int, digits: int) -> None:
    assert (block_bytes(size), digits_of(count, size)) == (count, digits)


def test_no_alphabet_wastes_more_than_one_part_in_a_hundred() -> None:
    for size in range(2, 257):
        payload = random.Random(size).randbytes(2000)
        symbols = encode_frame(payload, size)
        assert len(symbols) == frame_length(2000, size)
        assert len(symbols) * math.log2(size) <= 8 * 2006 / 0.99 + 3 * math.log2(size)
        assert push_all(Deframer(size), symbols) == [payload]


@pytest.mark.parametrize(("size", "bits"), [(2, 1), (4, 2), (16, 4)])
@given(payload=payloads)
def test_sizes_that_divide_a_byte_write_its_bits_in_order(
    size: int, bits: int, payload: bytes
) -> None:
    body = len(payload).to_bytes(2, "big") + payload
    body += zlib.crc32(body).to_bytes(4, "big")
    text = "".join(f"{byte:08b}" for byte in body)
    digits = [int(text[i : i + bits], 2) for i in range(0, len(text), bits)]
    assert encode_frame(payload, size) == bytes([1, *digits])


@settings(max_examples=200)
@given(sizes, payloads, st.randoms(use_true_random=False))
def test_one_damaged_symbol_is_never_a_message(
    size: int, payload: bytes, random: random.Random
) -> None:
    symbols = bytearray(encode_frame(payload, size))
    place = random.randrange(1, len(symbols))
    symbols[place] = (symbols[place] + random.randrange(1, size)) % size
    deframer = Deframer(size)
    found = next((p for s in symbols if (p := deframer.push(s)) is not None), None)
    assert found != payload
    assert deframer.refused or found is None


def test_every_frame_that_fails_is_counted_and_the_next_one_is_whole() -> None:
    whole = encode_frame(b"paper", 2)
    damaged = bytes([*whole[:-1], whole[-1] ^ 1])
    deframer = Deframer(2)
    assert (deframer.refused, deframer.ended) == (0, b"")
    assert push_all(deframer, damaged + damaged + whole + damaged + whole) == [b"paper"] * 2
    assert deframer.refused == 3


@given(st.integers(3, 256), payloads, st.data())
def test_anything_but_the_start_symbol_is_idle_between_frames(
    size: int, payload: bytes, data: st.DataObject
) -> None:
    between = st.lists(st.integers(0, size - 1).filter(lambda s: s != 1), max_size=50)
    noise = bytes(data.draw(between))
    deframer = Deframer(size)
    assert push_all(deframer, noise) == []
    assert push_all(deframer, encode_frame(payload, size) + noise) == [payload]
    assert not deframer.symbols


def test_digits_beyond_a_byte_are_refused_at_once() -> None:
    deframer = Deframer(3)
    assert push_all(deframer, bytes([1, *[2] * 10])) == []  # eleven digits hold a length
    before = deframer.refused
    assert deframer.push(2) is None
    assert (before, deframer.refused) == (0, 1)
    assert not deframer.symbols
    assert push_all(deframer, encode_frame(b"next", 3)) == [b"next"]


@given(sizes, payloads, payloads, st.data())
def test_a_restart_goes_on_from_the_symbols_kept(
    size: int, first: bytes, second: bytes, data: st.DataObject
) -> None:
    stream = encode_frame(first, size) + encode_frame(second, size)
    cut = data.draw(st.integers(0, len(stream)))
    before = Deframer(size)
    frames = push_all(before, stream[:cut])
    after = Deframer(size)
    assert push_all(after, bytes(before.symbols)) == []
    assert (after.partial, after.expected_length) == (before.partial, before.expected_length)
    frames += push_all(after, stream[cut:])
    assert frames == [first, second]


def test_the_longest_payload_fits_and_one_more_byte_does_not() -> None:
    payload = random.Random(7).randbytes(MAX_PAYLOAD)
    assert push_all(Deframer(16), encode_frame(payload, 16)) == [payload]
    with pytest.raises(ValueError, match="got 65536 bytes, expected at most 65535"):
        encode_frame(bytes(MAX_PAYLOAD + 1), 2)
